"""Percentiles are right to 1 % and never too low; extremes are exact."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.timing.durations import Distribution, Durations, curve_ms

DURATIONS_NS = st.lists(st.integers(0, 10**12), min_size=1, max_size=200)


def distribution(durations_ns: list[int]) -> Distribution:
    durations = Durations()
    for duration_ns in durations_ns:
        durations.add(duration_ns)
    found = durations.distribution()
    assert found is not None
    return found


def exact(durations_ns: list[int], percent: float) -> int:
    """The smallest duration that so many percent do not exceed."""
    return sorted(durations_ns)[max(math.ceil(len(durations_ns) * percent / 100.0) - 1, 0)]


@given(durations_ns=DURATIONS_NS)
def test_percentiles_are_right_to_one_percent_and_extremes_exactly(durations_ns: list[int]) -> None:
    found = distribution(durations_ns)
    assert found.count == len(durations_ns)
    assert (found.min_us, found.max_us) == (min(durations_ns) / 1e3, max(durations_ns) / 1e3)
    for value_us, percent in ((found.p50_us, 50.0), (found.p99_us, 99.0), (found.p99_9_us, 99.9)):
        # A bin is 1 % wide, and none is narrower than 512 ns.
        true_ns = exact(durations_ns, percent)
        assert value_us * 1e3 == pytest.approx(true_ns, rel=0.01, abs=512)
        assert true_ns / 1e3 <= value_us <= found.max_us
    assert curve_ms(found)[1][-1] == found.max_us / 1e3


def test_many_durations_are_counted_as_few_are() -> None:
    many = distribution([1_000_000 + 100 * number for number in range(10_000)])
    assert many.count == 10_000
    assert (many.min_us, many.max_us) == (1_000.0, 1_999.9)
    assert many.p50_us == pytest.approx(1_500, rel=0.01)


def test_of_nothing_there_are_no_figures() -> None:
    assert Durations().distribution() is None


def test_what_is_below_zero_or_beyond_an_hour_is_counted_at_the_end_of_the_scale() -> None:
    found = distribution([-5, 10**15])
    assert (found.count, found.min_us, found.max_us) == (2, 0.0, 3.6e9)


def test_a_curve_rises_from_the_least_duration_towards_the_greatest() -> None:
    times = distribution([1_000_000] * 900 + [10_000_000] * 99 + [100_000_000])
    shares, values_ms = curve_ms(times)
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == pytest.approx(0.0005, rel=0.2)  # half of one in a thousand
    at = dict(zip((round(share, 4) for share in shares), values_ms, strict=True))
    assert at[0.1] == pytest.approx(1.0, rel=0.01)
    assert at[0.01] == pytest.approx(10.0, rel=0.01)
    assert values_ms[-1] == pytest.approx(100.0, rel=0.01)
