"""When each recorded message is due: its position on a clock, and the time of that position.

How late messages were sent is kept in a histogram.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Literal, TypeAlias

import msgspec
from hdrh.histogram import HdrHistogram

from agents.plan import RunPlan
from recordings.read.reader import RecordedMessage

ClockKind: TypeAlias = Literal["sim", "wall"]
"""`sim`: a cycle begins when it does in simulated time, and within it messages are as far apart as
they were published. `wall`: all messages are as far apart as they were published."""

CLOCKS: Final[dict[ClockKind, str]] = {"sim": "simulated time", "wall": "recorded publish times"}

_LONGEST_NS: Final = 3_600_000_000_000
"""Lateness beyond it counts as this."""


class Positions:
    """Positions of messages on a clock [ns]; only their differences have a meaning."""

    def __init__(self, plan: RunPlan, kind: ClockKind) -> None:
        self._plan = plan
        self._kind = kind
        self._cycle = -1
        self._began_ns = 0
        self._last_ns = -(1 << 62)

    def next(self, record: RecordedMessage) -> int:
        """Return the position of the next message, never before that of the last one."""
        position_ns = record.publish_time_ns
        if self._kind == "sim":
            if record.cycle > self._cycle:
                self._cycle, self._began_ns = record.cycle, record.publish_time_ns
            elapsed_ns = min(record.publish_time_ns - self._began_ns, self._plan.cycle_ns)
            position_ns = self._plan.sim_time_ns(record.cycle) + elapsed_ns
        self._last_ns = max(self._last_ns, position_ns)
        return self._last_ns


class PlaybackClock:
    """Maps positions to times of the monotonic clock.

    Every time is counted from one anchor, so errors do not add up. Only a pause, a seek and a
    change of rate set a new anchor.
    The rate is in seconds of the clock per second; at 0 everything is due at once.
    """

    def __init__(
        self, rate: float, *, paused: bool = False, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.rate = rate
        self.paused = paused
        self.now_ns = now_ns
        self._position_ns = 0
        self._moment_ns = now_ns()

    def move_to(self, position_ns: int) -> None:
        """Make a position due now."""
        self._position_ns, self._moment_ns = position_ns, self.now_ns()

    def due_ns(self, position_ns: int) -> int:
        """Return the monotonic time at which a position is reached [ns]."""
        if self.rate == 0.0:
            return self._moment_ns
        return self._moment_ns + round((position_ns - self._position_ns) / self.rate)

    def toggle_pause(self) -> None:
        """Pause, or go on from the same position."""
        self.move_to(self._here_ns())
        self.paused = not self.paused

    def set_rate(self, rate: float) -> None:
        """Go on from here at another rate."""
        self.move_to(self._here_ns())
        self.rate = rate

    def _here_ns(self) -> int:
        if self.paused:
            return self._position_ns
        return self._position_ns + round((self.now_ns() - self._moment_ns) * self.rate)


class TimingFigures(msgspec.Struct, frozen=True):
    """Time of sending minus due time, over all messages that had one [µs]."""

    count: int
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float

    def text(self) -> str:
        """Return the figures as one line."""
        return (
            f"sent later than due: p50 {self.p50_us:,.0f} µs, p99 {self.p99_us:,.0f} µs, "
            f"p99.9 {self.p99_9_us:,.0f} µs, max {self.max_us:,.0f} µs"
        )


class TimingErrors:
    """How late messages were sent, in a histogram of bounded size."""

    def __init__(self) -> None:
        self._histogram = HdrHistogram(1, _LONGEST_NS, 3)

    def add(self, late_ns: int) -> None:
        self._histogram.record_value(min(max(late_ns, 1), _LONGEST_NS))

    def figures(self) -> TimingFigures | None:
        """Return the distribution; None if no message had a due time."""
        found, count = self._histogram, self._histogram.get_total_count()
        if not count:
            return None
        p50_us, p99_us, p99_9_us = (
            found.get_value_at_percentile(percent) / 1e3 for percent in (50.0, 99.0, 99.9)
        )
        return TimingFigures(count, p50_us, p99_us, p99_9_us, found.get_max_value() / 1e3)
