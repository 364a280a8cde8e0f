"""Gaps of a measured series, filled on straight lines in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError, listed
from sim_plant.csv_tables import CsvTable


class Filled(NamedTuple):
    """Values in one step: the length of the longest gap in them, and a line if any was filled."""

    values: pd.DataFrame
    longest_gap_s: float = 0.0
    report: tuple[str, ...] = ()


def without_gaps(
    table: CsvTable,
    column: str,
    time_ns: NDArray[np.int64],
    values: pd.DataFrame,
    max_gap_s: float | None,
) -> Filled:
    """Return a table's values, indexed by times [ns] in one step.

    `time_ns` are the times in `column`, `values` has a row for each; NaN is missing. A gap, missing
    values or missing lines, is as long as the steps that it lacks. One of at most `max_gap_s` is
    filled on the straight line from the value before it to the one after it; at the ends the
    nearest value holds. None: no line may be missing, and no value is filled.
    """
    table.check_steady(column, time_ns, may_lack=max_gap_s is not None)
    found = values.set_axis(pd.Index(time_ns))
    if max_gap_s is None:
        return Filled(found)
    step_ns = int(np.diff(time_ns).min())
    found = found.reindex(pd.RangeIndex(time_ns[0], time_ns[-1] + 1, step_ns))
    steps = found.apply(_steps_of_gaps)  # Of the gap that each missing value is in.
    longest, missing = steps.max(), (steps > 0).sum()
    limit = min(max_gap_s * 1e9 / step_ns, len(found) - 1)
    if (longest > limit).any():
        too_long = []
        for name in longest.index[longest > limit]:
            begins_ns = found.index[(steps[name] > limit).argmax()]
            line = table.fields.index[max(int(np.searchsorted(time_ns, begins_ns)) - 1, 0)] + 1
            too_long.append(f"{longest[name] * step_ns / 1e9:g} s of {name} (see line {line})")
        expected = f"gaps of at most {max_gap_s:g} s, as max_gap_s says"
        raise InputError(f"{table.name}: expected {expected}, got {listed(too_long)}")
    if not missing.any():
        return Filled(found)
    of_each = listed([f"{name} {count:,}" for name, count in missing.items() if count])
    longest_s = longest.max() * step_ns / 1e9
    quality = (
        f"{table.name}: {missing.sum():,} of {found.size:,} values were missing, in gaps of at "
        f"most {longest_s:g} s, and are interpolated: {of_each}"
    )
    return Filled(found.interpolate(limit_direction="both"), longest_s, (quality,))


def _steps_of_gaps(values: pd.Series) -> pd.Series:
    """Return, at each missing value, how many are missing in a row; 0 where there is a value."""
    missing = values.isna()
    return missing.groupby(missing.ne(missing.shift()).cumsum()).transform("sum")
