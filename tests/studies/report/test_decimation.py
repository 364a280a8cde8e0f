"""A line of a few points looks like the whole series, and a dip of one cycle is not lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from studies.report.decimation import extremes, least_per_bucket

SERIES = arrays(
    np.float64,
    st.integers(1, 300),
    elements=st.floats(-1e6, 1e6) | st.just(float("nan")),
)


def test_a_dip_of_one_cycle_in_a_day_is_kept() -> None:
    power_kw = np.full(54_000, 3000.0)
    power_kw[41_234] = 12.0
    rows = extremes(power_kw)
    assert 41_234 in rows
    assert len(rows) <= 3002


def test_a_peak_and_a_dip_in_one_bucket_are_kept_in_their_order() -> None:
    values = np.zeros(100)
    values[[42, 47]] = -1.0, 1.0
    assert {42, 47} <= set(extremes(values, buckets=10))
    assert list(extremes(values, buckets=10)) == sorted(extremes(values, buckets=10))


def test_a_short_series_is_kept_whole() -> None:
    assert list(extremes(np.array([3.0, 1.0, 2.0]), buckets=2)) == [0, 1, 2]


@given(SERIES, st.integers(1, 20))
def test_every_bucket_keeps_its_extremes_and_the_ends_are_there(
    values: NDArray[np.float64], buckets: int
) -> None:
    rows = extremes(values, buckets)
    assert len(rows) <= 2 * buckets + 2
    assert rows[0] == 0
    assert rows[-1] == len(values) - 1
    assert np.all(np.diff(rows) > 0)
    size = -(-len(values) // buckets)
    for begin in range(0, len(values), size):
        bucket = values[begin : begin + size]
        kept = values[rows[(rows >= begin) & (rows < begin + size)]]
        if not np.isnan(bucket).all():
            assert np.nanmin(kept) == np.nanmin(bucket)
            assert np.nanmax(kept) == np.nanmax(bucket)


def test_a_bucket_without_any_value_breaks_the_line() -> None:
    values = np.ones(40)
    values[10:20] = np.nan
    kept = values[extremes(values, buckets=4)]
    assert np.isnan(kept).sum() == 1


def test_the_least_of_each_bucket_of_several_series() -> None:
    values = np.array([[5.0, 1.0], [4.0, 2.0], [9.0, 0.0], [8.0, -1.0], [7.0, 3.0]])
    cells, rows = least_per_bucket(values, buckets=3)
    assert rows == 2
    # The last bucket has one row only.
    assert cells.tolist() == [[4.0, 1.0], [8.0, -1.0], [7.0, 3.0]]


def test_a_bucket_with_one_value_missing_shows_the_least_of_the_rest() -> None:
    values = np.array([[np.nan, np.nan], [2.0, np.nan]])
    cells, _ = least_per_bucket(values, buckets=1)
    assert cells[0, 0] == 2.0
    assert np.isnan(cells[0, 1])


@pytest.mark.parametrize("cycles", [1, 899, 900, 901, 54_000])
def test_a_heat_map_has_at_most_the_columns_asked_for_and_covers_all_cycles(cycles: int) -> None:
    cells, rows = least_per_bucket(np.arange(float(cycles))[:, None], buckets=900)
    assert len(cells) <= 900
    assert (len(cells) - 1) * rows < cycles <= len(cells) * rows
