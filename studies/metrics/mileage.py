"""Mileage of the support power: how much others had to ramp to fill the plant's gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SupportMileage:
    """Ramping of the support power s = max(0, desired - delivered).

    The paper gives mileages in kW (14 and 245) without a formula, a step or a time that they are
    for, so the sum is reported for the run, and as a rate for two units of time.

    Attributes
    ----------
    total_kw
        Sum over the run of |s(k+1) - s(k)| [kW], k counting cycles.
    per_hour_kw, per_minute_kw
        The same divided by the hours and by the minutes of the run [kW].
    """

    total_kw: float
    per_hour_kw: float
    per_minute_kw: float


def support_mileage(support_kw: NDArray[np.float64], cycle_s: float) -> SupportMileage:
    """Work out the mileage of the support power.

    Parameters
    ----------
    support_kw
        Power that others gave, cycle by cycle, shape (T,), T at least 1.
    cycle_s
        Length of a cycle [s].
    """
    total_kw = float(np.abs(np.diff(support_kw)).sum())
    hours = len(support_kw) * cycle_s / 3600.0
    return SupportMileage(total_kw, total_kw / hours, total_kw / (60.0 * hours))
