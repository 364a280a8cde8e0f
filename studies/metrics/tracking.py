"""How closely a plant followed the power that was desired, above it and below."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class TrackingError:
    """Deviation e = delivered - desired, over T cycles.

    Attributes
    ----------
    rmse_kw
        Root mean square error, sqrt(sum e^2 / T) [kW].
    mae_kw
        Mean absolute error, sum |e| / T [kW].
    """

    rmse_kw: float
    mae_kw: float


def tracking_error(
    desired_kw: NDArray[np.float64], delivered_kw: NDArray[np.float64]
) -> TrackingError:
    """Work out how closely a plant followed what was desired.

    Parameters
    ----------
    desired_kw, delivered_kw
        The plant cycle by cycle, shape (T,), T at least 1.
    """
    error_kw = delivered_kw - desired_kw
    return TrackingError(
        rmse_kw=float(np.sqrt(np.mean(error_kw**2))), mae_kw=float(np.mean(np.abs(error_kw)))
    )
