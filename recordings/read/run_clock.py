"""Moments of a run as a user writes them: local time, time since the start, or a cycle's number.

Cycles are numbered from 0, and cycle k begins at `start + k * cycle length`: a moment belongs to
the cycle that has begun by then. Every command uses this rule.
"""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, time, timedelta
from typing import Final, TypeAlias
from zoneinfo import ZoneInfo

from agents.plan import RunPlan
from bus_schemas.errors import InputError

Moment: TypeAlias = str | int
"""`13:49:00` or `2010-04-01T13:49:00` (local time), `90s` or `1h30m` (since the start), or a
cycle's number."""

EXPECTED: Final = (
    "expected a local time (13:49:00, 2010-04-01T13:49:00), a time since the start (90s, "
    "1h30m) or the number of a cycle"
)

_SECOND_NS: Final = 1_000_000_000
_YEAR_S: Final = 366 * 86_400
_SINCE_START: Final = re.compile(r"(?:(\d+)h)?(?:(\d+)m)?(?:(\d+(?:\.\d+)?)s)?")
_TIME_OF_DAY: Final = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d{1,6})?)?")


class RunClock:
    """Turns moments of a run into cycles, and cycles into local time."""

    def __init__(self, plan: RunPlan, last_cycle: int) -> None:
        self._plan = plan
        self._zone = ZoneInfo(plan.timezone)
        self._last_cycle = last_cycle

    def cycle(self, moment: Moment) -> int:
        """Return the cycle in which a moment lies."""
        text = str(moment).strip()
        cycle = int(text) if re.fullmatch(r"-?\d{1,18}", text) else self._cycle_at(text)
        if not 0 <= cycle <= self._last_cycle:
            raise InputError(f"{text}: outside the run, {self.extent()}")
        return cycle

    def span(self, start: Moment | None, end: Moment | None) -> range:
        """Return the cycles from one moment to another, both included; None: from or to the end."""
        first = 0 if start is None else self.cycle(start)
        last = self._last_cycle if end is None else self.cycle(end)
        if start is not None and end is not None and last < first:
            raise InputError(f"{end}: before {start}, expected a later moment")
        return range(first, last + 1)

    def local(self, cycle: int) -> datetime:
        """Return the local time at the beginning of a cycle."""
        seconds, rest_ns = divmod(self._plan.sim_time_ns(cycle), _SECOND_NS)
        # Adding to a local time would be ambiguous where clocks are put back.
        return datetime.fromtimestamp(seconds, self._zone).replace(microsecond=rest_ns // 1000)

    def text(self, cycle: int) -> str:
        """Return the local time of day of a cycle, as exact as the cycles need."""
        whole = self._plan.cycle_ns % _SECOND_NS == 0 == self._plan.start_time_ns % _SECOND_NS
        return self.local(cycle).strftime("%H:%M:%S" if whole else "%H:%M:%S.%f")[:12]

    def extent(self) -> str:
        """Say when the run begins and ends."""
        if self._last_cycle < 0:
            return "which has no cycle"
        first, last = self.local(0), self.local(self._last_cycle)
        end = self.text(self._last_cycle) if first.date() == last.date() else f"{last:%F %T}"
        return (
            f"which goes from {first:%Y-%m-%d} {self.text(0)} to {end} {last:%Z} "
            f"(cycles 0 to {self._last_cycle})"
        )

    def _cycle_at(self, text: str) -> int:
        since_start = _SINCE_START.fullmatch(text)
        if text and since_start is not None:
            hours, minutes, seconds = (float(part or 0.0) for part in since_start.groups())
            since_s = hours * 3600 + minutes * 60 + seconds
            # Longer than any run.
            return int(min(since_s, _YEAR_S) * _SECOND_NS) // self._plan.cycle_ns
        try:
            if _TIME_OF_DAY.fullmatch(text):
                return self._cycle_at_time_of_day(text)
            return self._cycle_of(datetime.fromisoformat(text))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{text[:40]}: not understood, {EXPECTED}") from None

    def _cycle_at_time_of_day(self, text: str) -> int:
        """Return the cycle at a time of day: of the one day of the run on which there is one."""
        clock = time.fromisoformat(text.zfill(len(text) + 1) if text[1] == ":" else text)
        day, last_day = self.local(0).date(), self.local(max(self._last_cycle, 0)).date()
        first = self._at(day, clock)
        found = []
        while day <= last_day:
            cycle = self._at(day, clock)
            if 0 <= cycle <= self._last_cycle:
                found.append(cycle)
            day += timedelta(days=1)
        if len(found) > 1:
            raise InputError(
                f"{text}: the run has {len(found)} of them, expected a date with it, "
                f"{self.local(found[0]):%Y-%m-%dT%H:%M:%S}"
            )
        return found[0] if found else first

    def _at(self, day: date, clock: time) -> int:
        return self._cycle_of(datetime.combine(day, clock))

    def _cycle_of(self, moment: datetime) -> int:
        if moment.tzinfo:
            return self._cycle_of_instant(moment)
        first = moment.replace(tzinfo=self._zone)
        second = first.replace(fold=1)
        if first.utcoffset() == second.utcoffset():
            return self._cycle_of_instant(first)
        # Clocks are put back or forward: the time of day comes twice, or not at all.
        if first.astimezone(UTC).astimezone(self._zone).replace(tzinfo=None) != moment:
            raise InputError(f"{moment:%F %T}: clocks are put forward over it, {EXPECTED}")
        raise InputError(
            f"{moment:%F %T}: comes twice, expected {first.isoformat()} or {second.isoformat()}"
        )

    def _cycle_of_instant(self, instant: datetime) -> int:
        whole = instant.replace(microsecond=0)
        instant_ns = int(whole.timestamp()) * _SECOND_NS + instant.microsecond * 1000
        return (instant_ns - self._plan.start_time_ns) // self._plan.cycle_ns
