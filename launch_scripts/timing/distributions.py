"""Distributions of durations: HDR histograms of many processes, and the figures read off them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from math import floor, log10
from typing import Final

import msgspec
from hdrh.histogram import HdrHistogram

from agents.histograms import Extremes, extremes_of, new_histogram

_US: Final = 1_000.0

_STEPS_PER_DECADE: Final = 12
"""How finely a curve is drawn: between 90 and 99 % as between 99 and 99.9 %."""


class Distribution(msgspec.Struct, frozen=True):
    """What a histogram of durations comes to.

    Attributes
    ----------
    count
        Number of durations.
    min_us, max_us
        Least and greatest [us], exactly.
    p50_us, p99_us, p99_9_us
        Percentiles [us]: the greatest duration that counts as the same, at most 1 % above, and
        none above the greatest of all. So a budget is never kept by rounding.
    histogram
        The HdrHistogram itself, encoded as text: values in ns. Others can merge it.
    """

    count: int
    min_us: float
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float
    histogram: str


def merged(encoded: Iterable[str]) -> HdrHistogram:
    """Return the histogram of all durations of several encoded ones."""
    total = new_histogram()
    for text in encoded:
        total.decode_and_add(text)
    return total


def together(extremes: Iterable[Extremes]) -> Extremes | None:
    """Return the extremes of all durations, of which these are parts; None of nothing."""
    found = list(extremes)
    return reduce(Extremes.with_others, found) if found else None


def distribution(histogram: HdrHistogram, extremes: Extremes | None = None) -> Distribution | None:
    """Return the figures of a histogram, None of an empty one.

    Parameters
    ----------
    histogram
        Of the durations.
    extremes
        Their least and greatest, which a histogram forgets when it is encoded. None: as far as the
        histogram knows them.
    """
    if not histogram.get_total_count():
        return None
    least_ns, greatest_ns = extremes or extremes_of(histogram)

    def percentile_us(percent: float) -> float:
        return float(min(histogram.get_value_at_percentile(percent), greatest_ns)) / _US

    return Distribution(
        count=histogram.get_total_count(),
        min_us=least_ns / _US,
        p50_us=percentile_us(50.0),
        p99_us=percentile_us(99.0),
        p99_9_us=percentile_us(99.9),
        max_us=greatest_ns / _US,
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
    histogram = merged([times.histogram])
    steps = floor(_STEPS_PER_DECADE * log10(2.0 * times.count))
    shares = [10.0 ** (-step / _STEPS_PER_DECADE) for step in range(steps + 1)]
    percents = [100.0 * (1.0 - share) for share in shares[:-1]]
    values_ms = [histogram.get_value_at_percentile(percent) / 1e6 for percent in percents]
    greatest_ms = times.max_us / 1e3
    return shares, [min(value_ms, greatest_ms) for value_ms in (*values_ms, greatest_ms)]
