"""Thins out long series to what a screen can show, without losing a peak or a dip."""

from __future__ import annotations

import numpy as np
import pandas as pd
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
    size = -(-length // buckets)
    table = np.full((-(-length // size), size), np.nan)
    table.flat[:length] = values
    first = np.arange(len(table)) * size
    missing = np.isnan(table)
    least = first + np.where(missing, np.inf, table).argmin(axis=1)
    greatest = first + np.where(missing, -np.inf, table).argmax(axis=1)
    return np.unique(np.concatenate([least, greatest, [0, length - 1]]))


def least_per_bucket(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Return the least value of each bucket of n series, shape (buckets, n), and rows per bucket.

    It is NaN where a bucket has nothing else. The last bucket may have fewer rows.
    """
    size = -(-len(values) // COLUMNS)
    return pd.DataFrame(values).groupby(np.arange(len(values)) // size).min().to_numpy(), size
