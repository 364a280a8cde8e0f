"""Times of a run as a user writes them: local time, seconds since the start, or a cycle.

Cycles are numbered from 0, and cycle k begins at `start + k * cycle length`: a time belongs to the
cycle that has begun by then. A time of day is the first one in the run. The end of a span is not
part of it. Every command uses these rules.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, time, timedelta
from typing import Final
from zoneinfo import ZoneInfo

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from scenarios.times import Cycle, When, on_day, parse_moment

_SECOND_NS: Final = 1_000_000_000


class RunClock:
    """Turns times of a run into cycles, and cycles into local time."""

    def __init__(self, plan: RunPlan, last_cycle: int) -> None:
        self.plan = plan
        self._zone = ZoneInfo(plan.timing.timezone)
        self._end = last_cycle + 1

    def cycle(self, when: When, where: str, *, is_end: bool = False) -> int:
        """Return the cycle of a time: `13:49:00`, `2010-04-01T13:49:00`, seconds, or `c90`.

        The end of a span may be the end of the run. An error is about `where`, such as `--from`.
        """
        for cycle in self._cycles_at(when, where):
            if 0 <= cycle < self._end + is_end:
                return cycle
        got = str(when).strip()[:40]
        raise InputError.of(where, f"expected a time of the run, {self.extent()}, got {got}")

    def span(
        self,
        start: When | None,
        end: When | None,
        names: tuple[str, str] = ("--from", "--to"),
    ) -> range:
        """Return the cycles from one time to before another; None: from or to the run's end."""
        first = 0 if start is None else self.cycle(start, names[0])
        stop = self._end if end is None else self.cycle(end, names[1], is_end=True)
        if end is not None and stop <= first:
            begin = "the beginning" if start is None else start
            raise InputError.of(names[1], f"expected a time after {begin}, got {end}")
        return range(first, stop)

    def local(self, cycle: int) -> datetime:
        seconds, rest_ns = divmod(self.plan.timing.sim_time_ns(cycle), _SECOND_NS)
        # Adding to a local time would be ambiguous where clocks are put back.
        local = datetime.fromtimestamp(seconds, self._zone)
        return local.replace(microsecond=rest_ns // 1000)

    def text(self, cycle: int) -> str:
        """Return the local time of day of a cycle."""
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

    def _cycles_at(self, when: When, where: str) -> Iterator[int]:
        """Yield the cycles that a time may mean: clocks that are put back show it twice."""
        moment = parse_moment(when, where)
        if isinstance(moment, Cycle):
            yield moment.number
        elif isinstance(moment, float):
            yield round(moment * _SECOND_NS) // self.plan.timing.cycle_ns
        else:
            for days in range(2 if isinstance(moment, time) else 1):
                day = self.local(0) + timedelta(days=days)
                yield from map(self._cycle_of, on_day(moment, day, where))

    def _cycle_of(self, local: datetime) -> int:
        moment_ns = round(local.timestamp() * 1e6) * 1000
        return (moment_ns - self.plan.timing.start_time_ns) // self.plan.timing.cycle_ns
