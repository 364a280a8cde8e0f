"""Finds a cloud passage that shows two virtual neighbours at work."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.control.correlation import HourlyMatrices, hourly_correlation
from bus_schemas.tree import parent_of
from recordings.read.series import RunSeries

DROP_S = 60.0
"""Longest time within which a fall of an inverter's maximum power counts as one drop."""

WINDOW_S = 180.0
"""How much of the run is shown around a drop: three minutes, as in the paper."""


@dataclass(frozen=True, slots=True)
class CloudPassage:
    """One inverter loses power while its virtual neighbour has some to spare.

    Both are positions in the plant's order; `correlation` is that of their maximum power within the
    hour. The IMPP of the shaded one fell by `drop_kw` within the minute before the cycle `bottom`.
    """

    shaded: int
    helping: int
    correlation: float
    bottom: int
    drop_kw: float
    cycles: range


def find_cloud_passage(series: RunSeries) -> CloudPassage | None:
    """Find the passage to show, by a fixed rule.

    In each hour of the run, the least correlated pair of each cluster is a candidate (eq. 5 of the
    paper). Of all candidates that is taken in which the IMPP of one falls the farthest within a
    minute, down to below its share, while the other's IMPP is above its own throughout that
    minute. None where no candidate has such a drop, or the scheme estimates no IMPP.
    """
    hours = hours_from_first_midnight(series)
    minute = max(1, round(DROP_S / series.cycle_s)) + 1
    # By how much each IMPP is below its greatest value of the minute before.
    greatest_kw = pd.DataFrame(series.impp_kw).rolling(minute, min_periods=1).max().to_numpy()
    drop_kw = np.nan_to_num(greatest_kw - series.impp_kw)
    needy = series.residual_kw < 0.0
    able = pd.DataFrame(series.residual_kw).rolling(minute, min_periods=1).min().to_numpy() > 0.0
    length = min(max(2, round(WINDOW_S / series.cycle_s)), series.cycles)
    best: CloudPassage | None = None
    candidates = [
        (hour, min(combinations(members, 2), key=lambda two: matrix[two]), matrix)
        for hour, matrix in correlation_by_hour(series).items()
        for members in clusters(series).values()
        if len(members) > 1
    ]
    for hour, pair, matrix in candidates:
        for shaded, helping in (pair, pair[::-1]):
            counts = (hours == hour) & needy[:, shaded] & able[:, helping]
            depth_kw = np.where(counts, drop_kw[:, shaded], 0.0)
            bottom = int(depth_kw.argmax())
            if (fell_kw := float(depth_kw[bottom])) > (best.drop_kw if best else 0.0):
                # The bottom is in the middle of what is shown, within the run.
                begin = min(max(0, bottom - length // 2), series.cycles - length)
                cycles = range(begin, begin + length)
                best = CloudPassage(shaded, helping, float(matrix[pair]), bottom, fell_kw, cycles)
    return best


def correlation_by_hour(series: RunSeries) -> HourlyMatrices:
    """Correlate the inverters' true maximum power within each local hour of the run (eq. 5).

    Hours count from the first day's midnight: 34 is 10 to 11 h of the second day. Hours in which
    no inverter's power varies, such as those of the night, are left out.
    """
    known = np.isfinite(series.mpp_kw).all(axis=1)
    matrices = hourly_correlation(series.mpp_kw[known], hours_from_first_midnight(series)[known])
    return {hour: matrix for hour, matrix in matrices.items() if np.any(matrix < 1.0)}


def hours_from_first_midnight(series: RunSeries) -> NDArray[np.int64]:
    """Return the local hour of each cycle, from 0; on the second day 24 to 47. Shape (T,)."""
    local = series.times.tz_localize(None)
    return np.asarray((local - local[0].normalize()) // pd.Timedelta(hours=1), dtype=np.int64)


def clusters(series: RunSeries) -> dict[str, list[int]]:
    """Return the positions of the inverters of each cluster, in the plant's order."""
    members: dict[str, list[int]] = {}
    for position, path in enumerate(series.inverters):
        members.setdefault(parent_of(path), []).append(position)
    return members


def inverters_by_cluster(series: RunSeries) -> list[int]:
    """Return the positions of all inverters, those of a cluster beside each other."""
    return [position for members in clusters(series).values() for position in members]
