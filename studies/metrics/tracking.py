"""How closely a plant followed the desired power, and how much its support had to ramp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class TrackingError:
    """Deviation e = delivered - desired over T cycles.

    Attributes
    ----------
    rmse_kw
        Root mean square error, sqrt(sum e^2 / T).
    mae_kw
        Mean absolute error, sum |e| / T.
    """

    rmse_kw: float
    mae_kw: float


def tracking_error(
    desired_kw: NDArray[np.float64], delivered_kw: NDArray[np.float64]
) -> TrackingError:
    """Compute the tracking error of a run: arrays of shape (T,), T at least 1."""
    error_kw = delivered_kw - desired_kw
    return TrackingError(
        rmse_kw=float(np.sqrt(np.mean(error_kw**2))), mae_kw=float(np.mean(np.abs(error_kw)))
    )


@dataclass(frozen=True, slots=True)
class SupportMileage:
    """Ramping of the support power s = max(0, desired - delivered).

    Attributes
    ----------
    total_kw
        Sum of |s(k+1) - s(k)| over the cycles k of the run.
    per_hour_kw, per_minute_kw
        The same divided by the hours and by the minutes of the run.
    """

    total_kw: float
    per_hour_kw: float
    per_minute_kw: float


def support_mileage(support_kw: NDArray[np.float64], cycle_s: float) -> SupportMileage:
    """Compute the mileage of support power of shape (T,), T at least 1; a cycle's length [s]."""
    total_kw = float(np.abs(np.diff(support_kw)).sum())
    hours = len(support_kw) * cycle_s / 3600.0
    return SupportMileage(total_kw, total_kw / hours, total_kw / (60.0 * hours))
