"""Distributions of durations: HDR histograms of many processes, and the figures read off them."""

from __future__ import annotations

from collections.abc import Iterable
from math import floor, log10
from typing import Final

import msgspec
from hdrh.histogram import HdrHistogram

from agents.histograms import new_histogram

_US: Final = 1_000.0

_STEPS_PER_DECADE: Final = 12
"""How finely a curve is drawn: between 90 and 99 % as between 99 and 99.9 %."""


class Distribution(msgspec.Struct, frozen=True):
    """What a histogram of durations comes to.

    Attributes
    ----------
    count
        Number of durations.
    min_us, p50_us, p99_us, p99_9_us, max_us
        Least, percentiles and greatest [us], to 1 %.
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


def distribution(histogram: HdrHistogram) -> Distribution | None:
    """Return the figures of a histogram, None of an empty one."""
    if not histogram.get_total_count():
        return None
    return Distribution(
        count=histogram.get_total_count(),
        min_us=histogram.get_min_value() / _US,
        p50_us=histogram.get_value_at_percentile(50.0) / _US,
        p99_us=histogram.get_value_at_percentile(99.0) / _US,
        p99_9_us=histogram.get_value_at_percentile(99.9) / _US,
        max_us=histogram.get_max_value() / _US,
        histogram=histogram.encode().decode("ascii"),
    )


def curve_ms(encoded: str) -> tuple[list[float], list[float]]:
    """Return percentiles of a histogram, as a curve to be drawn.

    Returns
    -------
    tuple of list
        Shares of the durations that exceed a value, from 1 down to half of one of them, in equal
        steps of their logarithm; and those values [ms].
    """
    histogram = merged([encoded])
    count = histogram.get_total_count()
    if not count:
        return [], []
    steps = floor(_STEPS_PER_DECADE * log10(2.0 * count))
    shares = [10.0 ** (-step / _STEPS_PER_DECADE) for step in range(steps + 1)]
    percents = [100.0 * (1.0 - share) for share in shares[:-1]]
    values = [histogram.get_value_at_percentile(percent) for percent in percents]
    return shares, [value / 1e6 for value in (*values, histogram.get_max_value())]
