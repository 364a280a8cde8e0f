"""Percentiles and extremes are exact; the histogram behind a curve is right to 1 %."""

from __future__ import annotations

import numpy as np
import pytest

from studies.timing.durations import curve_ms, distribution


@pytest.mark.parametrize(
    ("count", "p50_us", "p99_us", "p99_9_us"),
    [(10, 5, 10, 10), (1000, 500, 990, 999)],
)
def test_percentiles_are_durations_that_so_many_do_not_exceed(
    count: int, p50_us: float, p99_us: float, p99_9_us: float
) -> None:
    found = distribution(np.random.default_rng(1).permutation(np.arange(1, count + 1)) * 1000)
    assert (found.count, found.min_us, found.max_us) == (count, 1.0, count)
    assert (found.p50_us, found.p99_us, found.p99_9_us) == (p50_us, p99_us, p99_9_us)
    assert curve_ms(found)[1][-1] == found.max_us / 1e3


def test_a_duration_below_zero_counts_as_none() -> None:
    found = distribution(np.array([-10, 3000]))
    assert (found.min_us, found.p50_us, found.max_us) == (0.0, 0.0, 3.0)
