"""Percentiles are right to 1 % and never too low, extremes are exact, and merging keeps both."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from timings_by_hand import encoded

from agents.histograms import Extremes, new_histogram, record_ns
from launch_scripts.timing.distributions import (
    curve_ms,
    distribution,
    merged,
    together,
)

DURATIONS_NS = st.lists(st.integers(1_000, 10**12), min_size=1, max_size=200)


def exact(durations_ns: list[int], percent: float) -> int:
    """The smallest duration that so many percent do not exceed."""
    return sorted(durations_ns)[max(math.ceil(len(durations_ns) * percent / 100.0) - 1, 0)]


@given(durations_ns=DURATIONS_NS)
def test_percentiles_are_the_right_ones_to_one_percent(durations_ns: list[int]) -> None:
    histogram = new_histogram()
    for duration_ns in durations_ns:
        record_ns(histogram, duration_ns)
    found = distribution(histogram)
    assert found is not None
    assert found.count == len(durations_ns)
    for value_us, percent in ((found.p50_us, 50.0), (found.p99_us, 99.0), (found.max_us, 100.0)):
        # A bucket is 1 % wide, and none is narrower than 512 ns.
        assert value_us * 1e3 == pytest.approx(exact(durations_ns, percent), rel=0.01, abs=512)


@given(one=DURATIONS_NS, other=DURATIONS_NS)
def test_merged_histograms_are_the_histogram_of_all(one: list[int], other: list[int]) -> None:
    parts = [encoded([value / 1e6 for value in part]) for part in (one, other)]
    both = encoded([value / 1e6 for value in one + other])
    assert distribution(merged(parts)) == distribution(merged([both]))


@given(one=DURATIONS_NS, other=DURATIONS_NS)
def test_extremes_are_exact_and_no_percentile_is_too_low(one: list[int], other: list[int]) -> None:
    both = sorted(one + other)
    extremes = together(Extremes(min(part), max(part)) for part in (one, other))
    parts = [encoded([value / 1e6 for value in part]) for part in (one, other)]
    found = distribution(merged(parts), extremes)
    assert found is not None
    assert (found.min_us, found.max_us) == (both[0] / 1e3, both[-1] / 1e3)
    for value_us, percent in ((found.p50_us, 50.0), (found.p99_us, 99.0), (found.p99_9_us, 99.9)):
        assert exact(both, percent) / 1e3 <= value_us <= found.max_us
    assert curve_ms(found)[1][-1] == found.max_us / 1e3


def test_extremes_of_nothing_are_none() -> None:
    assert together([]) is None


def test_of_nothing_there_are_no_figures() -> None:
    assert distribution(new_histogram()) is None
    assert distribution(merged([])) is None


def test_what_is_below_zero_or_beyond_an_hour_is_counted_at_the_end_of_the_scale() -> None:
    histogram = new_histogram()
    record_ns(histogram, -5)
    record_ns(histogram, 10**15)
    found = distribution(histogram)
    assert found is not None
    assert (found.count, found.min_us) == (2, 0.0)
    assert found.max_us == pytest.approx(3.6e9, rel=0.01)


def test_a_curve_rises_from_the_least_duration_towards_the_greatest() -> None:
    times = distribution(merged([encoded([1.0] * 900 + [10.0] * 99 + [100.0])]))
    assert times is not None
    shares, values_ms = curve_ms(times)
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == pytest.approx(0.0005, rel=0.2)  # half of one in a thousand
    at = dict(zip((round(share, 4) for share in shares), values_ms, strict=True))
    assert at[0.1] == pytest.approx(1.0, rel=0.01)
    assert at[0.01] == pytest.approx(10.0, rel=0.01)
    assert values_ms[-1] == pytest.approx(100.0, rel=0.01)
