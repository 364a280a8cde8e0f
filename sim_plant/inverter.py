"""The inverter: what it delivers of its true maximum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def delivered_power_kw(
    mpp_kw: NDArray[np.float64], alpha: NDArray[np.float64], limit_kw: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return min(alpha x MPP, limit): one law for both actuators.

    The paper's inverter gives the share alpha of its maximum and has no limit below its rating.
    Its power follows every cloud within the interval, because alpha is a share of the maximum that
    is there, not of the one that was expected. A real inverter holds a power limit in its own fast
    loop (SunSpec model 123, `WMaxLimPct`, a share of nameplate power) at alpha = 1. The AC rating
    has clipped `mpp_kw` already.

    Parameters
    ----------
    mpp_kw
        True maximum AC power of each inverter, shape (n,).
    alpha
        Share of its maximum that each gives, in [0, 1], shape (n,).
    limit_kw
        Power that each does not exceed, shape (n,).

    Returns
    -------
    ndarray of float
        Delivered power [kW], shape (n,).
    """
    return np.minimum(alpha * mpp_kw, limit_kw)
