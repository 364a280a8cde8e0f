"""Percentiles and extremes are exact; the histogram behind a curve is right to 1 %."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.timing.durations import Distribution, curve_ms, distribution

DURATIONS_NS = st.lists(st.integers(-10, 10**12), min_size=1, max_size=200)


def of(durations_ns: list[int]) -> Distribution:
    return distribution(np.array(durations_ns))


def exact(durations_ns: list[int], percent: float) -> int:
    """The smallest duration that so many percent do not exceed."""
    return sorted(durations_ns)[max(math.ceil(len(durations_ns) * percent / 100.0) - 1, 0)]


@given(durations_ns=DURATIONS_NS)
def test_percentiles_and_extremes_are_exact(durations_ns: list[int]) -> None:
    found = of(durations_ns)
    assert found.count == len(durations_ns)
    assert found.min_us == max(min(durations_ns), 0) / 1e3
    assert found.max_us == max(*durations_ns, 0) / 1e3
    for value_us, percent in ((found.p50_us, 50.0), (found.p99_us, 99.0), (found.p99_9_us, 99.9)):
        assert value_us == max(exact(durations_ns, percent), 0) / 1e3
    assert curve_ms(found)[1][-1] == found.max_us / 1e3


def test_a_curve_rises_from_the_least_duration_towards_the_greatest() -> None:
    times = of([1_000_000] * 900 + [10_000_000] * 99 + [100_000_000])
    shares, values_ms = curve_ms(times)
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == pytest.approx(0.0005, rel=0.2)  # half of one in a thousand
    at = dict(zip((round(share, 4) for share in shares), values_ms, strict=True))
    assert at[0.1] == pytest.approx(1.0, rel=0.01)
    assert at[0.01] == pytest.approx(10.0, rel=0.01)
    assert values_ms[-1] == pytest.approx(100.0, rel=0.01)
