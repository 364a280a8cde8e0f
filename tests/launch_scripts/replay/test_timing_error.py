"""The distribution of timing errors has bounded size, and is exact to 0.8 %."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from launch_scripts.replay.timing_error import TimingError


def exact(errors_ns: list[int], percent: float) -> int:
    """The smallest error that so many percent do not exceed."""
    return sorted(errors_ns)[max(math.ceil(len(errors_ns) * percent / 100.0) - 1, 0)]


@given(
    errors_ns=st.lists(st.integers(0, 10**12), min_size=1, max_size=200),
    percent=st.sampled_from([0.1, 50.0, 99.0, 99.9, 100.0]),
)
def test_a_percentile_is_the_right_one_to_a_bucket(errors_ns: list[int], percent: float) -> None:
    timing = TimingError()
    for error_ns in errors_ns:
        timing.add(error_ns)
    wanted = exact(errors_ns, percent)
    assert wanted <= timing.percentile_ns(percent) <= wanted * (1 + 2**-7)
    assert (timing.count, timing.max_ns) == (len(errors_ns), max(errors_ns))
    assert timing.percentile_ns(100.0) == timing.max_ns


def test_small_errors_are_exact() -> None:
    timing = TimingError()
    for error_ns in range(256):
        timing.add(error_ns)
    assert [timing.percentile_ns(100.0 * (n + 1) / 256) for n in range(256)] == list(range(256))


def test_of_nothing_there_is_no_percentile() -> None:
    with pytest.raises(ValueError, match="no message"):
        TimingError().percentile_ns(50.0)
