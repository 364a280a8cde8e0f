"""Between a run and its real devices: a thread for each reads it and passes its commands on.

A process of its own beside the run, started by `GatewayProcess`.

A command is written at once if it says something new, and renewed after a third of the revert time
otherwise. A device is read late in each cycle, so that the plant's next telemetry is fresh. It
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
from math import inf, nan
from pathlib import Path
from typing import Final

import msgspec

from agents.control.storage import StorageLaw, ability
from agents.plan import RunPlan
from sim_plant.real_inverters import METER_PLACE, Reading
from sunspec.client import SunSpecDevice, SunSpecInverter, SunSpecMeter, SunSpecStorage
from sunspec.modbus_tcp import DeviceError, DeviceRefusedError, WrongAnswerError
from sunspec.pipes import GatewayPipes, Limit
from sunspec.process import DeviceAccount, Latency, log_in, write_accounts

_READ_AT: Final = 0.75
"""When an inverter is read, as a share of the cycle after the command came."""

_RETRY_S: Final = 1.0
_FIRST_TRIES: Final = 3
_ACCOUNTS_S: Final = 2.0
_QUIET_S: Final = 60.0
_TOO_LONG: Final = 0.9
"""Share of a cycle beyond which a round of requests is named as too long for it."""

_SAME_RATING: Final = 0.02
_EXCESS: Final = 0.01
"""Share of the rating by which a device may miss what it is told: its own measuring error."""


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
            for link in links:
                link.warn()
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


class _Voice:
    """Says what happens to a device: at once, and again only after a minute, with the number."""

    def __init__(self, node: str, tell: Callable[[str], None]) -> None:
        self._node, self._tell = node, tell
        self._counts: Counter[str] = Counter()
        self._quiet_until: dict[str, float] = {}

    def say(self, text: str, kind: str = "", count: int = 1) -> None:
        """Say a text, unless one of its kind was said less than a minute ago."""
        kind, now = kind or text, time.monotonic()
        self._counts[kind] += count
        if now >= self._quiet_until.get(kind, 0.0):
            count = self._counts.pop(kind)
            times = f" ({count:,} times in the last minute)" if count > 1 else ""
            self._tell(f"{self._node}: {text}{times}")
            self._quiet_until[kind] = now + _QUIET_S


class _Excess:
    """How far an inverter is above the limits that it has acknowledged, or a storage off its power.

    follows_s: Time in which it comes to obey.
    law: Of a storage, through the time in which it may run full or empty unnoticed.

    most_kw: Largest excess so far.
    """

    def __init__(
        self, follows_s: float, tolerance_kw: float, law: StorageLaw | None = None
    ) -> None:
        self.most_kw = 0.0
        self._law = law
        self._follows_s, self._tolerance_kw = follows_s, tolerance_kw
        self._limits: deque[tuple[float, float]] = deque()

    def limited(self, at: float, kw: float) -> None:
        self._limits.append((at, kw))

    def released(self) -> None:
        self._limits.clear()

    def of(self, at: float, reading: Reading) -> tuple[float, float]:
        """Return how far a power is from what was allowed, and that; 0 kW: not."""
        while len(self._limits) > 1 and self._limits[1][0] <= at - self._follows_s:
            self._limits.popleft()
        if not self._limits or self._limits[0][0] > at - self._follows_s:
            return 0.0, inf  # A limit before the first one is unknown.
        told_kw = [kw for _, kw in self._limits]
        least_kw, most_kw = -inf, max(told_kw)
        if self._law is not None:
            able = ability(reading.energy_kwh, reading.power_kw, self._law)
            least_kw = min(*told_kw, able.discharge_kw)
            most_kw = max(most_kw, -able.absorb_kw)
        allowed_kw = min(max(reading.power_kw, least_kw), most_kw)
        excess_kw = abs(reading.power_kw - allowed_kw)
        if excess_kw <= self._tolerance_kw:
            return 0.0, allowed_kw
        self.most_kw = max(self.most_kw, excess_kw)
        return excess_kw, allowed_kw


class _Link:
    """The link to one device, with its thread, and what is measured and counted of it."""

    def __init__(self, plan: RunPlan, node: str, address: str, tell: Callable[[str], None]) -> None:
        self._voice, self._node = _Voice(node, tell), node
        self._cycle_s = plan.timing.cycle_wall_ns / 1e9
        self._commands: deque[Limit] = deque(maxlen=1)
        self._wake, self._over = threading.Event(), threading.Event()
        self._late = self._refused = self._breaks = self._drops = 0
        self._gone_at: float | None = None
        self._reads, self._writes = (Latencies() for _ in range(2))
        self._first_read_s = 0.0
        self._written: int | None = None
        self._written_at = 0.0
        self._device: SunSpecDevice
        profile = plan.site.profile_of(node)
        self._revert = plan.site.revert
        if node == "meter":
            self.position = METER_PLACE
            self._device, self._excess = SunSpecMeter(address, profile), _Excess(inf, inf)
            return
        self.position = plan.tree.devices.index(node)
        self._rating_kw, self._capacity_kwh = plan.tree.rating_kw(node), nan
        tolerance_kw = ((profile.limit_step_percent or 0.0) / 100.0 + _EXCESS) * self._rating_kw
        if plan.tree.is_storage(node):
            (storage,) = (one for one in plan.storages if one.path == node)
            self._capacity_kwh = storage.capacity_kwh
            self._device, self._revert = SunSpecStorage(address, profile), plan.storage_revert
            ramp_s = 2.0 * storage.rating_kw / storage.law(1.0).ramp_kw  # From charge to discharge.
            follows_s = storage.delay_s + ramp_s + 2.0 * self._cycle_s
            self._excess = _Excess(follows_s, tolerance_kw, storage.law(follows_s))
            return
        self._device, self._revert = SunSpecInverter(address, profile), plan.site.revert_of(node)
        follows_s = plan.site.follows_within_s(node) + 2.0 * self._cycle_s
        self._excess = _Excess(follows_s, tolerance_kw)

    def connect(self) -> Reading:
        """Connect and read once, before there is a run."""
        for tries_left in reversed(range(_FIRST_TRIES)):
            try:
                self._device.connect()
                began_s = time.monotonic()
                reading = self._device.read()
                self._first_read_s = time.monotonic() - began_s
                return reading
            except DeviceError as error:
                is_passing = isinstance(error, WrongAnswerError) or (
                    isinstance(error, DeviceRefusedError) and error.is_passing
                )
                if not tries_left or not is_passing:
                    raise DeviceError(f"device {self._node}: {error}") from None
        raise AssertionError

    def begin(self, hand_over: Callable[[Reading], None]) -> None:
        self._thread = threading.Thread(target=self._run, args=[hand_over], daemon=True)
        self._thread.start()

    def warn(self) -> None:
        """Say what does not fit between device and plan."""
        device = self._device
        if not isinstance(device, SunSpecInverter):
            return
        sizes = [("rating", device.rating_kw, self._rating_kw, "kW")]
        if isinstance(device, SunSpecStorage):
            sizes.append(("capacity", device.capacity_kwh, self._capacity_kwh, "kWh"))
        for what, said, planned, unit in sizes:
            if abs(said - planned) > _SAME_RATING * planned:
                both = f"{said:,.10g} {unit}, and {planned:,.10g} {unit} in the scenario"
                self._voice.say(f"its {what} is {both}")
        reads, writes = device.requests
        round_s = self._first_read_s * (reads + writes) / reads
        if round_s > _TOO_LONG * self._cycle_s:
            requests = f"{reads} requests to read it and {writes} to command it"
            what = f"a cycle of {self._cycle_s:g} s is too short"
            self._voice.say(f"{what}: {requests} take {round_s:.1f} s; readings will be late")

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
            self._excess.most_kw,
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
                self._written = None  # The device may have lost the last one.
                self._voice.say(str(error))
            except DeviceError as error:
                self._written = None
                self._reconnect(error)
            self._count_drops()

    def _count_drops(self) -> None:
        if drops := self._device.drops - self._drops:
            self._drops += drops
            self._breaks += drops
            closed = "connection closed by the device"
            self._voice.say(f"{self._device.address}: {closed}", "closed", drops)

    def _read(self) -> Reading:
        before = self._device.state
        with self._reads.timed():
            reading = self._device.read()
        state = self._device.state
        if state != before and not {before, state} <= {"MPPT", "RUNNING", "THROTTLED"}:
            self._voice.say(f"{before or '-'} -> {state or '-'}")
        now = time.monotonic()
        if now > self._written_at + self._revert.after_s:
            self._excess.released()
        excess_kw, allowed_kw = self._excess.of(now, reading)
        if excess_kw:
            is_storage = isinstance(self._device, SunSpecStorage)
            over = "off its power of" if is_storage else "over its limit of"
            found = f"gives {reading.power_kw:,.4g} kW, {excess_kw:,.3g} kW {over}"
            self._voice.say(f"{found} {allowed_kw:,.4g} kW", over)
        return reading

    def _write(self, limit: Limit) -> None:
        """Write what is new, or without which the device would revert before long."""
        assert isinstance(self._device, SunSpecInverter)
        after_s, to, now = self._revert.after_s, self._revert.to, time.monotonic()
        register = self._device.register(limit.kw)
        is_due = now >= self._written_at + min(after_s / 3.0, 1e9)
        is_new = register != self._written
        if not is_due and self._written is not None:
            pause_s = self._device.profile.write_every_s
            if not is_new or now < self._written_at + pause_s:
                return
        revert_kw = limit.revert_kw
        if not isinstance(to, str):
            revert_kw = to * self._rating_kw
        elif to == "release":
            revert_kw = nan
        with self._writes.timed():
            self._device.set_power(limit.kw, after_s, revert_kw)
        self._written, self._written_at = register, time.monotonic()
        self._excess.limited(self._written_at, limit.kw)

    def _reconnect(self, error: DeviceError) -> None:
        """Try until the device is back."""
        self._breaks += 1
        self._gone_at = time.monotonic()
        self._excess.released()
        self._voice.say(f"{error}; trying again", "gone")
        while not self._over.is_set():
            try:
                self._device.close()
                self._device.connect()
            except DeviceError:
                self._over.wait(_RETRY_S)
            else:
                self._gone_at = None
                self._voice.say("connected again", "back")
                return


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
