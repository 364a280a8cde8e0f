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


@pytest.mark.parametrize("cycles", [1, 899, 900, 901, 54_000])
def test_a_heat_map_has_at_most_the_columns_asked_for_and_covers_all_cycles(cycles: int) -> None:
    cells, rows = least_per_bucket(np.arange(float(cycles))[:, None], buckets=900)
    assert len(cells) <= 900
    assert (len(cells) - 1) * rows < cycles <= len(cells) * rows
