"""Thins out long series to what a screen can show, without losing a peak or a dip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BUCKETS = 1500
"""Buckets of a line: more than a screen has pixels across a figure."""

COLUMNS = 900
"""Columns of a heat map."""


def extremes(values: NDArray[np.float64], buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Find the rows of a series that a line must go through to look like the whole series.

    Of each bucket the least and the greatest value are kept, besides the first and the last of the
    series; of a bucket of NaN its first row, so that a line is broken there.
    """
    length = len(values)
    if length <= 2 * buckets:
        return np.arange(length)
    table = _in_buckets(values, buckets)
    first = np.arange(len(table)) * table.shape[1]
    missing = np.isnan(table)
    least = first + np.where(missing, np.inf, table).argmin(axis=1)
    greatest = first + np.where(missing, -np.inf, table).argmax(axis=1)
    return np.unique(np.concatenate([least, greatest, [0, length - 1]]))


def least_per_bucket(
    values: NDArray[np.float64], buckets: int = COLUMNS
) -> tuple[NDArray[np.float64], int]:
    """Return the least value of each bucket of n series, shape (buckets, n), and rows per bucket.

    It is NaN where a bucket has nothing else. The last bucket may have fewer rows.
    """
    columns = [_in_buckets(series, buckets) for series in values.T]
    return np.column_stack([np.fmin.reduce(table, axis=1) for table in columns]), len(columns[0][0])


def _in_buckets(values: NDArray[np.float64], buckets: int) -> NDArray[np.float64]:
    """Lay a series out with a bucket a row, the last one filled up with NaN."""
    size = -(-len(values) // buckets)
    rows = -(-len(values) // size)
    table = np.full(rows * size, np.nan)
    table[: len(values)] = values
    return table.reshape(rows, size)
