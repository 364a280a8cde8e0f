"""Between a run and its real inverters: a thread for each reads it and passes its commands on.

A process of its own beside the run, started by `GatewayProcess`.

A command is written at once if it says something new, and renewed after a third of the revert time
otherwise. An inverter is read late in each cycle, so that the plant's next telemetry is fresh. It
gets no commands but those of the controllers: without them nothing is renewed, and it reverts.
"""

from __future__ import annotations

import logging
import os
import select
import sys
import threading
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import accumulate
from math import nan
from pathlib import Path
from typing import Final

import msgspec

from agents.plan import RunPlan
from sim_plant.real_inverters import METER, Reading
from sunspec.client import (
    DeviceError,
    DeviceRefusedError,
    SunSpecDevice,
    SunSpecInverter,
    SunSpecMeter,
)
from sunspec.pipes import GatewayPipes, Limit
from sunspec.process import DeviceAccount, Latency, log_in, write_accounts

_READ_AT: Final = 0.75
"""When an inverter is read, as a share of the cycle after the command came."""

_RETRY_S: Final = 1.0
_ACCOUNTS_S: Final = 2.0
_SMALL_CHANGE: Final = 1e-4
"""Share of the rating that no inverter can tell apart: 0.01 %."""


class Gateway:
    """The real inverters of a run, and its meter if that is real, connected.

    tell: Called with a line for the launcher, in any thread; an empty one: a run can begin.
    """

    def __init__(self, plan: RunPlan, tell: Callable[[str], None]) -> None:
        self._tell = tell
        devices = dict(plan.site.devices) | ({"meter": plan.site.meter} if plan.site.meter else {})
        links = [_Link(plan, node, address, tell) for node, address in devices.items()]
        self._links = {link.position: link for link in links}
        with ThreadPoolExecutor(len(links)) as pool:
            self._first = dict(zip(self._links, pool.map(_Link.connect, links), strict=True))

    def serve(self, folder: Path, until: int) -> None:
        """Serve the run in a folder until a file descriptor is at its end."""
        pipes, links = GatewayPipes(folder), self._links.values()
        try:
            for position, link in self._links.items():
                pipes.hand_reading(position, self._first[position])
                link.begin(partial(pipes.hand_reading, position))
            self._tell("")
            account_at = time.monotonic()
            while until not in select.select([until, pipes.commands], [], [], _ACCOUNTS_S)[0]:
                for position, limit in pipes.take_limits():
                    self._links[position].command(limit)
                if time.monotonic() > account_at:
                    account_at = time.monotonic() + _ACCOUNTS_S
                    write_accounts(folder, tuple(link.account() for link in links))
            for link in links:
                link.stop()
            write_accounts(folder, tuple(link.account() for link in links))
        finally:
            pipes.close()


class Latencies:
    """How long requests took, to two digits."""

    def __init__(self) -> None:
        self._counts: Counter[float] = Counter()

    @contextmanager
    def timed(self) -> Iterator[None]:
        began_s = time.monotonic()
        yield
        self._counts[float(f"{1e3 * (time.monotonic() - began_s):.2g}")] += 1

    def latency(self) -> Latency:
        if not self._counts:
            return Latency(0, 0.0, 0.0)
        values_ms = sorted(self._counts)
        sums = [*accumulate(self._counts[ms] for ms in values_ms)]
        p50_ms, p99_ms = (values_ms[bisect_left(sums, part * sums[-1])] for part in (0.5, 0.99))
        return Latency(sums[-1], p50_ms, p99_ms)


class _Link:
    """The link to one device, with its thread, and what is measured and counted of it."""

    def __init__(self, plan: RunPlan, node: str, address: str, tell: Callable[[str], None]) -> None:
        self._tell, self._said, self._node = tell, "", node
        self._cycle_s = plan.timing.cycle_wall_ns / 1e9
        self._commands: deque[Limit] = deque(maxlen=1)
        self._wake, self._over = threading.Event(), threading.Event()
        self._late = self._refused = self._breaks = 0
        self._gone_at: float | None = None
        self._reads, self._writes = (Latencies() for _ in range(2))
        self._written_kw, self._written_at = nan, 0.0  # Any limit differs from NaN.
        self._device: SunSpecDevice
        if node == "meter":
            self.position = METER
            self._device = SunSpecMeter(address)
            return
        self.position = plan.tree.leaves.index(node)
        self._rating_kw, self._revert = plan.tree.rating_kw(node), plan.site.revert_of(node)
        self._device = SunSpecInverter(address)

    def connect(self) -> Reading:
        """Connect and read once, before there is a run."""
        try:
            self._device.connect()
            return self._device.read()
        except DeviceError as error:
            raise DeviceError(f"device {self._node}: {error}") from None

    def begin(self, hand_over: Callable[[Reading], None]) -> None:
        self._thread = threading.Thread(target=self._run, args=[hand_over], daemon=True)
        self._thread.start()

    def command(self, limit: Limit) -> None:
        self._commands.append(limit)
        self._wake.set()

    def stop(self) -> None:
        self._over.set()
        self._wake.set()
        self._thread.join(_RETRY_S)

    def account(self) -> DeviceAccount:
        return DeviceAccount(
            self._node,
            self._device.address,
            self._reads.latency(),
            self._writes.latency(),
            self._late,
            self._refused,
            self._breaks,
            None if self._gone_at is None else time.monotonic() - self._gone_at,
        )

    def _run(self, hand_over: Callable[[Reading], None]) -> None:
        read_at = time.monotonic() + self._cycle_s
        while not self._over.is_set():
            self._wake.wait(max(read_at - time.monotonic(), 0.0))
            self._wake.clear()
            try:
                if self._commands:
                    read_at = time.monotonic() + _READ_AT * self._cycle_s
                    self._write(self._commands.pop())
                if time.monotonic() >= read_at:
                    late_at = read_at + (1.0 - _READ_AT) * self._cycle_s
                    read_at = max(read_at + self._cycle_s, time.monotonic())
                    hand_over(self._read())
                    self._late += time.monotonic() > late_at
            except DeviceRefusedError as error:
                self._refused += 1
                self._written_kw = nan  # The inverter may have lost the last limit.
                self._say(str(error))
            except DeviceError as error:
                self._written_kw = nan
                self._reconnect(error)

    def _read(self) -> Reading:
        before = self._device.state
        with self._reads.timed():
            reading = self._device.read()
        state = self._device.state
        if state != before and not {before, state} <= {"MPPT", "RUNNING", "THROTTLED"}:
            self._say(f"{before or '-'} -> {state or '-'}")
        return reading

    def _write(self, limit: Limit) -> None:
        """Write a limit that is new, or without which the inverter would revert before long."""
        assert isinstance(self._device, SunSpecInverter)
        after_s, to = self._revert.after_s, self._revert.to
        is_as_before = abs(limit.kw - self._written_kw) < _SMALL_CHANGE * self._device.rating_kw
        if is_as_before and time.monotonic() < self._written_at + after_s / 3.0:
            return
        revert_kw = limit.revert_kw
        if not isinstance(to, str):
            revert_kw = to * self._rating_kw
        elif to == "release":
            revert_kw = nan
        with self._writes.timed():
            self._device.limit(limit.kw, after_s, revert_kw)
        self._written_kw, self._written_at = limit.kw, time.monotonic()

    def _reconnect(self, error: DeviceError) -> None:
        """Try until the device is back."""
        self._breaks += 1
        self._gone_at = time.monotonic()
        self._say(f"{error}; trying again")
        while not self._over.is_set():
            try:
                self._device.close()
                self._device.connect()
            except DeviceError:
                self._over.wait(_RETRY_S)
            else:
                self._gone_at = None
                self._say("connected again")
                return

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._tell(f"{self._node}: {text}")


def _tell(text: str) -> None:
    if text:
        logging.info(text)
    os.write(1, os.fsencode(" ".join(text.split())) + b"\n")


def main() -> None:
    """Connect to the inverters of a plan, then serve the run in a folder until the input ends."""
    plan = msgspec.json.decode(sys.stdin.buffer.readline(), type=RunPlan)
    try:
        gateway = Gateway(plan, _tell)
    except DeviceError as error:
        _tell(str(error))
        return
    _tell("")
    if line := sys.stdin.buffer.readline():
        folder = Path(os.fsdecode(line.rstrip(b"\n")))
        with log_in(folder).open("ab") as log:
            os.dup2(log.fileno(), 2)
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
        logging.info("connected: %s", ", ".join(node for node, _ in plan.site.devices))
        gateway.serve(folder, sys.stdin.fileno())


if __name__ == "__main__":
    main()
