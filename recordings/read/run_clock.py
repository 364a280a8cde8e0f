"""Times of a run as a user writes them: local time, time since the start, or a cycle's number.

Cycles are numbered from 0, and cycle k begins at `start + k * cycle length`: a time belongs to the
cycle that has begun by then. A time of day is the first one in the run. The end of a span is not
part of it. Every command uses these rules.
"""

from __future__ import annotations

import re
from datetime import datetime, time, timedelta
from typing import Final
from zoneinfo import ZoneInfo

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from scenarios.times import LONGEST_S, duration_s, on_day, read_time

_FORMS: Final = (
    "a local time (13:49:00, 2010-04-01T13:49:00), a time since the start (90s, 1h30m) or the "
    "number of a cycle"
)
_SECOND_NS: Final = 1_000_000_000


class RunClock:
    """Turns times of a run into cycles, and cycles into local time."""

    def __init__(self, plan: RunPlan, last_cycle: int) -> None:
        self.plan = plan
        self._zone = ZoneInfo(plan.timing.timezone)
        self._end = last_cycle + 1

    def cycle(self, when: str | int, where: str, *, is_end: bool = False) -> int:
        """Return the cycle of a time: `13:49:00`, `2010-04-01T13:49:00`, `90s` or a number.

        The end of a span may be the end of the run. An error begins with `where`, such as `--from`.
        """
        text = str(when).strip()
        try:
            cycle = int(text) if re.fullmatch(r"-?\d{1,18}", text) else self._cycle_at(text)
            if not 0 <= cycle < self._end + is_end:
                raise InputError(f"a time of the run, {self.extent()}")
        except InputError as expected:
            raise InputError(f"{where}: expected {expected}, got {text[:40]}") from None
        return cycle

    def span(
        self,
        start: str | int | None,
        end: str | int | None,
        names: tuple[str, str] = ("--from", "--to"),
    ) -> range:
        """Return the cycles from one time to before another; None: from or to the run's end."""
        first = 0 if start is None else self.cycle(start, names[0])
        stop = self._end if end is None else self.cycle(end, names[1], is_end=True)
        if end is not None and stop <= first:
            begin = "the beginning" if start is None else start
            raise InputError(f"{names[1]}: expected a time after {begin}, got {end}")
        return range(first, stop)

    def local(self, cycle: int) -> datetime:
        seconds, rest_ns = divmod(self.plan.timing.sim_time_ns(cycle), _SECOND_NS)
        # Adding to a local time would be ambiguous where clocks are put back.
        local = datetime.fromtimestamp(seconds, self._zone)
        return local.replace(microsecond=rest_ns // 1000)

    def text(self, cycle: int) -> str:
        """Return the local time of day of a cycle, as exact as the cycles need."""
        timing = self.plan.timing
        whole = timing.cycle_ns % _SECOND_NS == timing.start_time_ns % _SECOND_NS == 0
        return self.local(cycle).strftime("%H:%M:%S" if whole else "%H:%M:%S.%f")[:12]

    def span_text(self, first: int, last: int) -> str:
        if first == last:
            return f"in cycle {first:,} ({self.text(first)})"
        return f"in cycles {first:,} to {last:,} ({self.text(first)} to {self.text(last)})"

    def extent(self) -> str:
        if not self._end:
            return "of which no cycle was recorded"
        last_cycle = self._end - 1
        first, last = self.local(0), self.local(last_cycle)
        return f"which goes from {first:%F %T} to {last:%F %T %Z} (cycles 0 to {last_cycle})"

    def _cycle_at(self, text: str) -> int:
        since_start_s = duration_s(text)
        if since_start_s is not None:
            since_start_s = min(since_start_s, 2 * LONGEST_S)
            return round(since_start_s * _SECOND_NS) // self.plan.timing.cycle_ns
        moment = read_time(text)
        if moment is None:
            raise InputError(_FORMS)
        local = on_day(moment, self.local(0))
        if isinstance(moment, time) and self._cycle_of(local) < 0:
            local += timedelta(days=1)
        return self._cycle_of(local)

    def _cycle_of(self, local: datetime) -> int:
        moment_ns = round(local.timestamp() * 1e6) * 1000
        return (moment_ns - self.plan.timing.start_time_ns) // self.plan.timing.cycle_ns
