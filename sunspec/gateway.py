"""Between a run and its real inverters: a thread for each reads it and passes its commands on.

A command is written at once if it says something new, and renewed after a third of the revert time
otherwise. An inverter is read late in each cycle, so that the plant's next telemetry is fresh. It
is commanded by nobody else: what comes from no controller is not renewed, and the inverter reverts.
"""

from __future__ import annotations

import select
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from math import inf, nan
from pathlib import Path
from typing import Final, TypeAlias

from hdrh.histogram import HdrHistogram

from agents.plan import RunPlan
from sim_plant.devices import Pipes, Reading
from sunspec.client import DeviceError, DeviceRefusedError, SunSpecInverter
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
        links = [_Link(plan, node, address, tell) for node, address in plan.devices]
        with ThreadPoolExecutor(len(links)) as pool:
            list(pool.map(_Link.connect, links))
        self._links = {link.place: link for link in links}

    def serve(self, folder: Path, until: int) -> None:
        """Serve the run in a folder until a file descriptor is at its end."""
        pipes = Pipes(folder)
        try:
            for link in self._links.values():
                link.begin(pipes)
            self._tell("")
            told_at = 0.0
            while until not in select.select([until, pipes.commands], [], [], _ACCOUNTS_S)[0]:
                for place, limit_kw, revert_kw in pipes.take_commands():
                    self._links[place].command((limit_kw, revert_kw))
                if time.monotonic() > told_at + _ACCOUNTS_S:
                    told_at = time.monotonic()
                    self._account(folder)
            for link in self._links.values():
                link.stop()
            for link in self._links.values():
                link.thread.join(_RETRY_S)
            self._account(folder)
        finally:
            pipes.close()

    def _account(self, folder: Path) -> None:
        write_accounts(folder, tuple(link.account() for link in self._links.values()))


class _Link:
    """The link to one inverter, with its thread."""

    def __init__(self, plan: RunPlan, node: str, address: str, tell: Callable[[str], None]) -> None:
        self.place = plan.tree.leaves.index(node)
        revert = plan.settings_of(node).revert
        self._node, self._tell = node, tell
        self._cycle_s = plan.cycle_wall_ns / 1e9
        self._revert_s = revert.after_s if revert else 0.0
        self._renew_s = self._revert_s / 3.0 if revert else inf
        self._revert_to = revert.to if revert else "release"
        self._rating_kw = plan.tree.rating_kw(node)
        self._inverter = SunSpecInverter(address, needs_revert=revert is not None)
        self._reading: Reading | None = None
        self._commands: deque[Limit] = deque(maxlen=1)
        self._wake, self._over = threading.Event(), threading.Event()
        self._written_kw = nan  # What differs from it is written in any case.
        self._written_at = 0.0
        self._late = self._refused = self._breaks = 0
        self._gone_at: float | None = None
        self._said = ""
        self._took = {what: HdrHistogram(1, _LONGEST_US, 2) for what in ("read", "write")}

    def connect(self) -> None:
        """Connect and read once, before there is a run."""
        try:
            self._inverter.connect()
            self._reading = self._inverter.read()
        except DeviceError as error:
            raise DeviceError(f"device {self._node}: {error}") from None

    def begin(self, pipes: Pipes) -> None:
        self._pipes = pipes
        assert self._reading is not None
        pipes.hand_reading(self.place, self._reading)
        self.thread = threading.Thread(target=self._run, name=self._node, daemon=True)
        self.thread.start()

    def command(self, limit: Limit) -> None:
        self._commands.append(limit)
        self._wake.set()

    def stop(self) -> None:
        self._over.set()
        self._wake.set()

    def account(self) -> DeviceAccount:
        reads, writes = map(_latency, self._took.values())
        gone_at = self._gone_at
        gone_s = None if gone_at is None else time.monotonic() - gone_at
        address, counts = self._inverter.address, (self._late, self._refused, self._breaks)
        return DeviceAccount(self._node, address, reads, writes, *counts, gone_s)

    def _run(self) -> None:
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
                    self._read()
                    self._late += time.monotonic() > late_at
            except DeviceRefusedError as error:
                self._refused += 1
                self._written_kw = nan
                self._say(str(error))
            except DeviceError as error:
                self._reconnect(error)

    def _read(self) -> None:
        before = self._inverter.state
        with self._timed("read"):
            reading = self._inverter.read()
        self._pipes.hand_reading(self.place, reading)
        state = self._inverter.state
        if state != before and not {before, state} <= {"MPPT", "RUNNING", "THROTTLED"}:
            self._say(f"{before or '-'} -> {state or '-'}")

    def _write(self, limit: Limit) -> None:
        """Write a limit if it is new, or the inverter would revert before long."""
        limit_kw, revert_kw = limit
        if self._revert_to == "release":
            revert_kw = None
        elif self._revert_to != "request":
            revert_kw = self._revert_to * self._rating_kw
        is_as_before = abs(limit_kw - self._written_kw) < _SMALL_CHANGE * self._inverter.rating_kw
        if is_as_before and time.monotonic() < self._written_at + self._renew_s:
            return
        with self._timed("write"):
            self._inverter.limit(limit_kw, self._revert_s, revert_kw)
        self._written_kw, self._written_at = limit_kw, time.monotonic()

    def _reconnect(self, error: DeviceError) -> None:
        """Try until the inverter is back. It may have lost its limit, so the next one is new."""
        self._breaks += 1
        self._gone_at = time.monotonic()
        self._say(f"{error}; trying again")
        self._written_kw = nan
        while not self._over.is_set():
            try:
                self._inverter.close()
                self._inverter.connect()
            except DeviceError:
                self._over.wait(_RETRY_S)
            else:
                self._gone_at = None
                self._say("connected again")
                return

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        began_ns = time.monotonic_ns()
        yield
        took_us = (time.monotonic_ns() - began_ns) // 1_000
        self._took[what].record_value(min(max(took_us, 1), _LONGEST_US))

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._tell(f"{self._node}: {text}")


def _latency(took: HdrHistogram) -> Latency:
    p50_us, p99_us = map(took.get_value_at_percentile, (50.0, 99.0))
    return Latency(took.get_total_count(), p50_us / 1e3, p99_us / 1e3)
