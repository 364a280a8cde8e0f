"""Durations by the million: HDR histograms with exact extremes, and the figures read off them."""

from __future__ import annotations

from array import array
from math import floor, log10
from typing import Final

import msgspec
import numpy as np
from hdrh.histogram import HdrHistogram

_LOWEST_NS: Final = 1_000
_HIGHEST_NS: Final = 3_600_000_000_000
_FIGURES: Final = 2
"""What a histogram tells apart: 1 us to 1 h, to 1 %."""

_UNIT_NS: Final = 512
"""Width of the narrowest bin of such a histogram."""

_PENDING: Final = 4_096
_STEPS_PER_DECADE: Final = 12
"""How finely a curve is drawn: between 90 and 99 % as between 99 and 99.9 %."""


class Distribution(msgspec.Struct, frozen=True):
    """A summary of durations.

    Attributes
    ----------
    min_us, max_us
        Exact [us].
    p50_us, p99_us, p99_9_us
        Upper edge of the bin [us]: at most 1 % too high and never above the maximum, so that
        rounding never makes a budget look kept.
    histogram
        The HdrHistogram encoded as text, values in ns. Others can merge it.
    """

    count: int
    min_us: float
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float
    histogram: str


class Durations:
    """Durations of one kind. One below 0 counts as 0, one above an hour as an hour."""

    __slots__ = ("_histogram", "_pending", "greatest_ns", "least_ns")

    def __init__(self) -> None:
        self.least_ns = _HIGHEST_NS
        self.greatest_ns = 0
        self._histogram = HdrHistogram(_LOWEST_NS, _HIGHEST_NS, _FIGURES)
        self._pending = array("q")

    def add(self, duration_ns: int) -> None:
        """Take in a duration [ns]."""
        self._pending.append(duration_ns)
        if len(self._pending) >= _PENDING:
            self._count()

    def _count(self) -> None:
        """Count what is pending: many values fall into one bin, and a call for each is slow."""
        if not self._pending:
            return
        values = np.clip(np.frombuffer(self._pending, dtype=np.int64), 0, _HIGHEST_NS)
        self.least_ns = min(self.least_ns, int(values.min()))
        self.greatest_ns = max(self.greatest_ns, int(values.max()))
        for unit, count in zip(*np.unique(values // _UNIT_NS, return_counts=True), strict=True):
            self._histogram.record_value(int(unit) * _UNIT_NS, int(count))
        self._pending = array("q")

    def distribution(self) -> Distribution | None:
        """Return the figures; None if there are no durations."""
        self._count()
        histogram, greatest_ns = self._histogram, self.greatest_ns
        if not histogram.get_total_count():
            return None

        def percentile_us(percent: float) -> float:
            return float(min(histogram.get_value_at_percentile(percent), greatest_ns)) / 1e3

        return Distribution(
            count=histogram.get_total_count(),
            min_us=self.least_ns / 1e3,
            p50_us=percentile_us(50.0),
            p99_us=percentile_us(99.0),
            p99_9_us=percentile_us(99.9),
            max_us=greatest_ns / 1e3,
            histogram=histogram.encode().decode("ascii"),
        )


def curve_ms(times: Distribution) -> tuple[list[float], list[float]]:
    """Return percentiles of durations, as a curve to be drawn.

    Returns
    -------
    tuple of list
        Shares of the durations that exceed a value, from 1 down to half of one of them, in equal
        steps of their logarithm; and those values [ms].
    """
    histogram = HdrHistogram(_LOWEST_NS, _HIGHEST_NS, _FIGURES)
    histogram.decode_and_add(times.histogram)
    steps = floor(_STEPS_PER_DECADE * log10(2.0 * times.count))
    shares = [10.0 ** (-step / _STEPS_PER_DECADE) for step in range(steps + 1)]
    percents = [100.0 * (1.0 - share) for share in shares[:-1]]
    values_ms = [histogram.get_value_at_percentile(percent) / 1e6 for percent in percents]
    greatest_ms = times.max_us / 1e3
    return shares, [min(value_ms, greatest_ms) for value_ms in (*values_ms, greatest_ms)]
