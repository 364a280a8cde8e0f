"""Percentiles of durations, and their HDR histogram."""

from __future__ import annotations

from math import floor, log10
from typing import Final

import msgspec
import numpy as np
from hdrh.histogram import HdrHistogram
from numpy.typing import NDArray

_LOWEST_NS: Final = 1_000
_HIGHEST_NS: Final = 3_600_000_000_000
_FIGURES: Final = 2
"""What a histogram tells apart: 1 us to 1 h, to 1 %."""

_UNIT_NS: Final = 512
"""Width of the narrowest bin of such a histogram."""

_STEPS_PER_DECADE: Final = 12
"""How finely a curve is drawn: between 90 and 99 % as between 99 and 99.9 %."""


class Distribution(msgspec.Struct, frozen=True):
    """A summary of durations. A percentile is the least one that so many percent do not exceed.

    All figures are exact. The histogram is an HdrHistogram encoded as text, with values in ns.
    """

    count: int
    min_us: float
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float
    histogram: str


class Times(msgspec.Struct, frozen=True):
    """A row of durations: `decision` of `direct estimate`, `hop` of `residual`.

    `kind` is that of the agents, or the signal, and names the budget if `of` does not.
    """

    measure: str
    of: str
    kind: str
    times: Distribution


def distribution(durations_ns: NDArray[np.int64]) -> Distribution:
    """Summarise one duration or more; below 0 counts as 0, above an hour as an hour."""
    ascending = np.sort(durations_ns.clip(0, _HIGHEST_NS))
    histogram = HdrHistogram(_LOWEST_NS, _HIGHEST_NS, _FIGURES)
    # Many durations fall into one bin, and a call for each is slow.
    for unit, count in zip(*np.unique(ascending // _UNIT_NS, return_counts=True), strict=True):
        histogram.record_value(int(unit) * _UNIT_NS, int(count))
    p50_ns, p99_ns, p99_9_ns = np.quantile(ascending, (0.5, 0.99, 0.999), method="inverted_cdf")
    return Distribution(
        count=len(ascending),
        min_us=float(ascending[0]) / 1e3,
        p50_us=float(p50_ns) / 1e3,
        p99_us=float(p99_ns) / 1e3,
        p99_9_us=float(p99_9_ns) / 1e3,
        max_us=float(ascending[-1]) / 1e3,
        histogram=histogram.encode().decode("ascii"),
    )


def curve_ms(times: Distribution) -> tuple[list[float], list[float]]:
    """Return a curve to be drawn: shares of the durations that exceed a value, and those values.

    The shares go from 1 down to half of one duration, in equal steps of their logarithm.
    """
    histogram = HdrHistogram(_LOWEST_NS, _HIGHEST_NS, _FIGURES)
    histogram.decode_and_add(times.histogram)
    steps = floor(_STEPS_PER_DECADE * log10(2.0 * times.count))
    shares = [10.0 ** (-step / _STEPS_PER_DECADE) for step in range(steps + 1)]
    percents = [100.0 * (1.0 - share) for share in shares[:-1]]
    values_ms = [histogram.get_value_at_percentile(percent) / 1e6 for percent in percents]
    greatest_ms = times.max_us / 1e3
    return shares, [min(value_ms, greatest_ms) for value_ms in (*values_ms, greatest_ms)]
