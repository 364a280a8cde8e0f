"""How late a replay sent its messages."""

from __future__ import annotations

from typing import Final

import msgspec
from hdrh.histogram import HdrHistogram

_LONGEST_NS: Final = 3_600_000_000_000


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
        """Count one message."""
        self._histogram.record_value(min(max(late_ns, 1), _LONGEST_NS))

    def figures(self) -> TimingFigures | None:
        """Return the distribution; None if no message had a due time."""
        found = self._histogram
        if not found.get_total_count():
            return None
        p50_us, p99_us, p99_9_us = (
            found.get_value_at_percentile(percent) / 1e3 for percent in (50.0, 99.0, 99.9)
        )
        count, max_us = found.get_total_count(), found.get_max_value() / 1e3
        return TimingFigures(count, p50_us, p99_us, p99_9_us, max_us)
