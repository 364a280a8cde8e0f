"""Percentiles and extremes are exact; the histogram behind a curve is right to 1 %."""

from __future__ import annotations

import math

import numpy as np
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
