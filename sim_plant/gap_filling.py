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
from sim_plant import Floats
from sim_plant.irradiance import Irradiance
from sim_plant.sites import east_north_m

_NEAREST: Final = 3
_LONGEST_LINE: Final = 60
"""Values in a row that may be missing in all sensors."""

_SAME_PLACE_M: Final = 1.0


def fill_from_neighbours(irradiance: Irradiance) -> Irradiance:
    """Fill missing values (NaN), and report for each sensor what was filled."""
    ghi_wm2 = irradiance.ghi_wm2
    missing = np.isnan(ghi_wm2)
    all_missing = np.asarray(missing.all(axis=1), dtype=np.bool_)
    east_m, north_m = east_north_m(irradiance.lat_deg, irradiance.lon_deg)
    distance_m = np.hypot(east_m[:, None] - east_m, north_m[:, None] - north_m)
    distance_m = np.maximum(distance_m, _SAME_PLACE_M)
    filled = ghi_wm2.copy()
    report = list(irradiance.report)
    for sensor in np.flatnonzero((missing & ~all_missing[:, None]).any(axis=0)):
        gaps = missing[:, sensor] & ~all_missing
        order = np.argsort(distance_m[sensor], kind="stable")
        order = order[order != sensor]
        mean_wm2 = _weighted_mean(ghi_wm2[:, order], distance_m[sensor, order])
        level = _level(ghi_wm2[:, sensor], mean_wm2)
        filled[gaps, sensor] = level * mean_wm2[gaps]
        report.append(
            f"{irradiance.sensors[sensor]}: {int(gaps.sum()):,} of {len(gaps):,} values missing,"
            f" filled from the nearest sensors times {level:.3f}"
        )
    if all_missing.any():
        lines = pd.DataFrame(filled).interpolate(limit=_LONGEST_LINE, limit_area="inside")
        filled = lines.to_numpy()
        left = np.isnan(filled).any(axis=1)
        if left.any():
            raise InputError(
                f"{irradiance.source}: line {left.argmax() + 1}: expected at most {_LONGEST_LINE} "
                "lines without any value, between lines with values"
            )
        report.append(
            f"all sensors: {int(all_missing.sum()):,} of {len(all_missing):,} values missing at the"
            " same time, interpolated from the values before and after"
        )
    return replace(irradiance, ghi_wm2=filled, report=tuple(report))


def _weighted_mean(ghi_wm2: Floats, distance_m: Floats) -> Floats:
    """Mean of the nearest sensors that have a value, NaN where none has.

    The sensors are given in the order of their distance.
    """
    there = ~np.isnan(ghi_wm2)
    used = there & (np.cumsum(there, axis=1) <= _NEAREST)
    weight = used / distance_m**2
    total = weight.sum(axis=1)
    weighted = (np.where(used, ghi_wm2, 0.0) * weight).sum(axis=1)
    return np.asarray(
        np.divide(weighted, total, out=np.full(len(total), np.nan), where=total > 0.0)
    )


def _level(own_wm2: Floats, mean_wm2: Floats) -> float:
    """Ratio of the sensor to its neighbours while both were there; 1 where that says nothing."""
    both = ~np.isnan(own_wm2) & ~np.isnan(mean_wm2)
    of_neighbours = float(mean_wm2[both].sum())
    return float(own_wm2[both].sum()) / of_neighbours if of_neighbours > 0.0 else 1.0
