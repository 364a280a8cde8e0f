"""Between a run and its real inverters: a thread for each reads it and passes its commands on.

A command is written at once if it says something new, and renewed after a third of the revert time
otherwise. An inverter is read late in each cycle, so that the plant's next telemetry is fresh. It
gets no commands but those of the controllers: without them nothing is renewed, and it reverts.
"""

from __future__ import annotations

import select
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from math import inf, nan
from pathlib import Path
from typing import Final

from hdrh.histogram import HdrHistogram

from agents.plan import RunPlan
from agents.settings import Revert
from sim_plant.real_inverters import METER, Reading
from sunspec.client import (
    DeviceError,
    DeviceRefusedError,
    SunSpecDevice,
    SunSpecInverter,
    SunSpecMeter,
)
from sunspec.pipes import GatewayPipes, Limit
from sunspec.process import DeviceAccount, Latency, write_accounts

_READ_AT: Final = 0.75
"""When an inverter is read, as a share of the cycle after the command came."""

_RETRY_S: Final = 1.0
_ACCOUNTS_S: Final = 2.0
_LONGEST_US: Final = 60_000_000
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


class _Tally:
    """What is measured and counted of one inverter."""

    def __init__(self) -> None:
        self.late = self.refused = self.breaks = 0
        self.gone_at: float | None = None
        self.reads, self.writes = (HdrHistogram(1, _LONGEST_US, 2) for _ in range(2))

    def account(self, node: str, address: str) -> DeviceAccount:
        gone_s = None if self.gone_at is None else time.monotonic() - self.gone_at
        took = _latency(self.reads), _latency(self.writes)
        return DeviceAccount(node, address, *took, self.late, self.refused, self.breaks, gone_s)


class _LimitWriter:
    """Writes limits to an inverter where they are new, or it would revert before long."""

    def __init__(self, revert: Revert | None, rating_kw: float, inverter: SunSpecInverter) -> None:
        self.written_kw = nan  # Any limit differs from it.
        self._inverter = inverter
        self._rating_kw = rating_kw
        self._revert = revert or Revert(inf, "release")
        self._written_at = 0.0

    def write(self, limit: Limit, took: HdrHistogram) -> None:
        after_s, to, revert_kw = self._revert.after_s, self._revert.to, limit.revert_kw
        if to != "share":
            revert_kw = nan if to == "release" else to * self._rating_kw
        is_as_before = abs(limit.kw - self.written_kw) < _SMALL_CHANGE * self._inverter.rating_kw
        if is_as_before and time.monotonic() < self._written_at + after_s / 3.0:
            return
        with _timed(took):
            self._inverter.limit(limit.kw, 0.0 if after_s == inf else after_s, revert_kw)
        self.written_kw, self._written_at = limit.kw, time.monotonic()


class _Link:
    """The link to one device, with its thread."""

    def __init__(self, plan: RunPlan, node: str, address: str, tell: Callable[[str], None]) -> None:
        self._tell, self._said = tell, ""
        self._cycle_s = plan.timing.cycle_wall_ns / 1e9
        self._node = node
        self._tally = _Tally()
        self._commands: deque[Limit] = deque(maxlen=1)
        self._wake, self._over = threading.Event(), threading.Event()
        self._device: SunSpecDevice
        if node == "meter":
            self.position = METER
            self._device, self._writer = SunSpecMeter(address), None
        else:
            self.position = plan.tree.leaves.index(node)
            revert = plan.site.settings_of(node).revert
            self._device = inverter = SunSpecInverter(address, needs_revert=revert is not None)
            self._writer = _LimitWriter(revert, plan.tree.rating_kw(node), inverter)

    def connect(self) -> Reading:
        """Connect and read once, before there is a run."""
        try:
            self._device.connect()
            return self._device.read()
        except DeviceError as error:
            raise DeviceError(f"device {self._node}: {error}") from None

    def begin(self, hand_over: Callable[[Reading], None]) -> None:
        """Read and limit the device, in a thread."""
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
        return self._tally.account(self._node, self._device.address)

    def _run(self, hand_over: Callable[[Reading], None]) -> None:
        read_at = time.monotonic() + self._cycle_s
        while not self._over.is_set():
            self._wake.wait(max(read_at - time.monotonic(), 0.0))
            self._wake.clear()
            try:
                if self._commands and self._writer is not None:
                    read_at = time.monotonic() + _READ_AT * self._cycle_s
                    self._writer.write(self._commands.pop(), self._tally.writes)
                if time.monotonic() >= read_at:
                    late_at = read_at + (1.0 - _READ_AT) * self._cycle_s
                    read_at = max(read_at + self._cycle_s, time.monotonic())
                    hand_over(self._read())
                    self._tally.late += time.monotonic() > late_at
            except DeviceRefusedError as error:
                self._tally.refused += 1
                self._forget_limit()
                self._say(str(error))
            except DeviceError as error:
                self._reconnect(error)

    def _read(self) -> Reading:
        before = self._device.state
        with _timed(self._tally.reads):
            reading = self._device.read()
        state = self._device.state
        if state != before and not {before, state} <= {"MPPT", "RUNNING", "THROTTLED"}:
            self._say(f"{before or '-'} -> {state or '-'}")
        return reading

    def _forget_limit(self) -> None:
        """Write the next limit in any case: the inverter may have lost the last one."""
        if self._writer is not None:
            self._writer.written_kw = nan

    def _reconnect(self, error: DeviceError) -> None:
        """Try until the device is back."""
        self._tally.breaks += 1
        self._tally.gone_at = time.monotonic()
        self._say(f"{error}; trying again")
        self._forget_limit()
        while not self._over.is_set():
            try:
                self._device.close()
                self._device.connect()
            except DeviceError:
                self._over.wait(_RETRY_S)
            else:
                self._tally.gone_at = None
                self._say("connected again")
                return

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._tell(f"{self._node}: {text}")


@contextmanager
def _timed(took: HdrHistogram) -> Iterator[None]:
    began_ns = time.monotonic_ns()
    yield
    took_us = (time.monotonic_ns() - began_ns) // 1_000
    took.record_value(min(max(took_us, 1), _LONGEST_US))


def _latency(took: HdrHistogram) -> Latency:
    p50_us, p99_us = map(took.get_value_at_percentile, (50.0, 99.0))
    return Latency(took.get_total_count(), p50_us / 1e3, p99_us / 1e3)
