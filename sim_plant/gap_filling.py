r"""Missing values of an irradiance sensor, filled from the sensors around it.

The rule is Shepard's inverse-distance weighting (doi:10.1145/800186.810616) over the nearest
sensors, brought to the missing sensor's own level:

.. math::

    G_i(t) = r_i \frac{\sum_j G_j(t) / d_{ij}^2}{\sum_j 1 / d_{ij}^2}, \qquad
    r_i = \frac{\sum_s G_i(s)}{\sum_s \hat G_i(s)}

j runs over the three nearest sensors that have a value at t; s over all times at which sensor i
has a value itself, and its neighbours' weighted mean is the second sum. Few neighbours, because a
mean over many is smoother than any sensor under broken clouds. Where no sensor at all has a value,
each is drawn on a straight line in time from its last to its next, for 60 values at most.

`tests/sim_plant/test_gap_filling.py` measures the quality with the HOPE-Melpitz data: 20 minutes
are removed from each of 17 stations in turn. The filled values have a median RMSE of 60 W/m^2 and
0.97 of the true standard deviation, 200 W/m^2. A straight line in time has an RMSE of 244 W/m^2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from sim_plant.irradiance import Irradiance
from sim_plant.sites import east_north_m

_NEAREST: Final = 3
_LONGEST_LINE: Final = 60
"""Values in a row that may be missing in all sensors."""

_SAME_PLACE_M: Final = 1.0


def fill_from_neighbours(irradiance: Irradiance) -> Irradiance:
    """Fill missing values (NaN), and report for each sensor what was filled."""
    ghi_wm2 = irradiance.ghi_wm2
    all_missing = ghi_wm2.isna().all(axis=1)
    gaps = ghi_wm2.isna().loc[~all_missing]
    distances_m = _distances_m(irradiance.coordinates)
    filled, report = ghi_wm2.copy(), list(irradiance.report)
    for sensor in gaps.columns[gaps.any()]:
        others = distances_m[sensor].drop(sensor).sort_values(kind="stable")
        mean_wm2 = _weighted_mean(ghi_wm2[others.index], others)
        level = _level(ghi_wm2[sensor], mean_wm2)
        times = gaps.index[gaps[sensor]]
        filled.loc[times, sensor] = level * mean_wm2[times]
        report.append(
            f"{sensor}: {len(times):,} of {len(ghi_wm2):,} values missing,"
            f" filled from the nearest sensors times {level:.3f}"
        )
    if all_missing.any():
        filled = filled.interpolate(limit=_LONGEST_LINE, limit_area="inside")
        unfilled = filled.isna().any(axis=1).to_numpy()
        if unfilled.any():
            raise InputError(
                f"{irradiance.source}: line {unfilled.argmax() + 1}: expected at most "
                f"{_LONGEST_LINE} lines without any value, between lines with values"
            )
        report.append(
            f"all sensors: {all_missing.sum():,} of {len(ghi_wm2):,} values missing at the"
            " same time, interpolated from the values before and after"
        )
    return replace(irradiance, ghi_wm2=filled, report=tuple(report))


def _distances_m(coordinates: pd.DataFrame) -> pd.DataFrame:
    east_m, north_m = east_north_m(coordinates["lat"].to_numpy(), coordinates["lon"].to_numpy())
    distances_m = np.hypot(east_m[:, None] - east_m, north_m[:, None] - north_m)
    return pd.DataFrame(
        np.maximum(distances_m, _SAME_PLACE_M), coordinates.index, coordinates.index
    )


def _weighted_mean(ghi_wm2: pd.DataFrame, distances_m: pd.Series) -> pd.Series:
    """Mean of the nearest sensors that have a value, NaN where none has.

    The sensors are given in the order of their distance.
    """
    there = ghi_wm2.notna()
    weight = (there & (there.cumsum(axis=1) <= _NEAREST)) / distances_m**2
    return (ghi_wm2 * weight).sum(axis=1) / weight.sum(axis=1)


def _level(own_wm2: pd.Series, mean_wm2: pd.Series) -> float:
    """Ratio of the sensor to its neighbours while both were there; 1 where that says nothing."""
    both = own_wm2.notna() & mean_wm2.notna()
    of_neighbours = float(mean_wm2[both].sum())
    return float(own_wm2[both].sum()) / of_neighbours if of_neighbours > 0.0 else 1.0
