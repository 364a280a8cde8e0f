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
from typing import Final, TypeAlias

from hdrh.histogram import HdrHistogram

from agents.plan import RunPlan
from sim_plant.real_inverters import Reading
from sunspec.client import DeviceError, DeviceRefusedError, SunSpecInverter
from sunspec.pipes import GatewayPipes
from sunspec.process import DeviceAccount, Latency, write_accounts

_READ_AT: Final = 0.75
"""When an inverter is read, as a share of the cycle after the command came."""

_RETRY_S: Final = 1.0
_ACCOUNTS_S: Final = 2.0
_LONGEST_US: Final = 60_000_000
_SMALL_CHANGE: Final = 1e-4
"""Share of the rating that no inverter can tell apart: 0.01 %."""

Limit: TypeAlias = tuple[float, float | None]
"""A limit, and the one after the revert time [kW]."""


class Gateway:
    """The real inverters of a run, connected.

    tell: Called with a line for the launcher, in any thread; an empty one: a run can begin.
    """

    def __init__(self, plan: RunPlan, tell: Callable[[str], None]) -> None:
        self._tell = tell
        links = [_Link(plan, node, address, tell) for node, address in plan.site.devices]
        with ThreadPoolExecutor(len(links)) as pool:
            readings = list(pool.map(_Link.connect, links))
        self._links = {link.position: link for link in links}
        self._first = {link.position: one for link, one in zip(links, readings, strict=True)}

    def serve(self, folder: Path, until: int) -> None:
        """Serve the run in a folder until a file descriptor is at its end."""
        pipes = GatewayPipes(folder)
        try:
            threads = []
            for position, link in self._links.items():
                hand_over = partial(pipes.hand_reading, position)
                hand_over(self._first[position])
                threads.append(link.begin(hand_over))
            self._tell("")
            account_at = time.monotonic()
            while until not in select.select([until, pipes.commands], [], [], _ACCOUNTS_S)[0]:
                for position, limit_kw, revert_kw in pipes.take_commands():
                    self._links[position].command((limit_kw, revert_kw))
                if time.monotonic() > account_at:
                    account_at = time.monotonic() + _ACCOUNTS_S
                    self._account(folder)
            for link in self._links.values():
                link.stop()
            for thread in threads:
                thread.join(_RETRY_S)
            self._account(folder)
        finally:
            pipes.close()

    def _account(self, folder: Path) -> None:
        write_accounts(folder, tuple(link.account() for link in self._links.values()))


class _Tally:
    """What is measured and counted of one inverter."""

    def __init__(self) -> None:
        self.late = self.refused = self.breaks = 0
        self.gone_at: float | None = None
        self.reads, self.writes = (HdrHistogram(1, _LONGEST_US, 2) for _ in range(2))

    def account(self, node: str, address: str) -> DeviceAccount:
        return DeviceAccount(
            node=node,
            address=address,
            reads=_latency(self.reads),
            writes=_latency(self.writes),
            late=self.late,
            refused=self.refused,
            breaks=self.breaks,
            gone_s=None if self.gone_at is None else time.monotonic() - self.gone_at,
        )


class _LimitWriter:
    """Writes limits to an inverter where they are new, or it would revert before long."""

    def __init__(self, plan: RunPlan, node: str, inverter: SunSpecInverter) -> None:
        revert = plan.site.settings_of(node).revert
        self._inverter = inverter
        self._revert_s = revert.after_s if revert else 0.0
        self._renew_s = self._revert_s / 3.0 if revert else inf
        self._revert_to = revert.to if revert else "release"
        self._rating_kw = plan.tree.rating_kw(node)
        self._written_kw = nan  # Any limit differs from it.
        self._written_at = 0.0

    def forget(self) -> None:
        """Write the next limit in any case: the inverter may have lost the last one."""
        self._written_kw = nan

    def write(self, limit: Limit, took: HdrHistogram) -> None:
        limit_kw, revert_kw = limit
        if self._revert_to == "release":
            revert_kw = None
        elif self._revert_to != "share":
            revert_kw = self._revert_to * self._rating_kw
        is_as_before = abs(limit_kw - self._written_kw) < _SMALL_CHANGE * self._inverter.rating_kw
        if is_as_before and time.monotonic() < self._written_at + self._renew_s:
            return
        with _timed(took):
            self._inverter.limit(limit_kw, self._revert_s, revert_kw)
        self._written_kw, self._written_at = limit_kw, time.monotonic()


class _Link:
    """The link to one inverter, with its thread."""

    def __init__(self, plan: RunPlan, node: str, address: str, tell: Callable[[str], None]) -> None:
        self.position = plan.tree.leaves.index(node)
        self.tally = _Tally()
        self._node, self._tell, self._said = node, tell, ""
        self._cycle_s = plan.timing.cycle_wall_ns / 1e9
        has_revert = plan.site.settings_of(node).revert is not None
        self._inverter = SunSpecInverter(address, needs_revert=has_revert)
        self._writer = _LimitWriter(plan, node, self._inverter)
        self._commands: deque[Limit] = deque(maxlen=1)
        self._wake, self._over = threading.Event(), threading.Event()

    def connect(self) -> Reading:
        """Connect and read once, before there is a run."""
        try:
            self._inverter.connect()
            return self._inverter.read()
        except DeviceError as error:
            raise DeviceError(f"device {self._node}: {error}") from None

    def begin(self, hand_over: Callable[[Reading], None]) -> threading.Thread:
        """Read and limit the inverter, in a thread."""
        thread = threading.Thread(target=self._run, args=[hand_over], name=self._node, daemon=True)
        thread.start()
        return thread

    def command(self, limit: Limit) -> None:
        self._commands.append(limit)
        self._wake.set()

    def stop(self) -> None:
        self._over.set()
        self._wake.set()

    def account(self) -> DeviceAccount:
        return self.tally.account(self._node, self._inverter.address)

    def _run(self, hand_over: Callable[[Reading], None]) -> None:
        read_at = time.monotonic() + self._cycle_s
        while not self._over.is_set():
            self._wake.wait(max(read_at - time.monotonic(), 0.0))
            self._wake.clear()
            try:
                if self._commands:
                    read_at = time.monotonic() + _READ_AT * self._cycle_s
                    self._writer.write(self._commands.pop(), self.tally.writes)
                if time.monotonic() >= read_at:
                    late_at = read_at + (1.0 - _READ_AT) * self._cycle_s
                    read_at = max(read_at + self._cycle_s, time.monotonic())
                    hand_over(self._read())
                    self.tally.late += time.monotonic() > late_at
            except DeviceRefusedError as error:
                self.tally.refused += 1
                self._writer.forget()
                self._say(str(error))
            except DeviceError as error:
                self._reconnect(error)

    def _read(self) -> Reading:
        before = self._inverter.state
        with _timed(self.tally.reads):
            reading = self._inverter.read()
        state = self._inverter.state
        if state != before and not {before, state} <= {"MPPT", "RUNNING", "THROTTLED"}:
            self._say(f"{before or '-'} -> {state or '-'}")
        return reading

    def _reconnect(self, error: DeviceError) -> None:
        """Try until the inverter is back."""
        self.tally.breaks += 1
        self.tally.gone_at = time.monotonic()
        self._say(f"{error}; trying again")
        self._writer.forget()
        while not self._over.is_set():
            try:
                self._inverter.close()
                self._inverter.connect()
            except DeviceError:
                self._over.wait(_RETRY_S)
            else:
                self.tally.gone_at = None
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
