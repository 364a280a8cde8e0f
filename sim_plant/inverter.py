"""The inverter: what it delivers of its true maximum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def delivered_power_kw(
    mpp_kw: NDArray[np.float64], alpha: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Apply curtailment levels to true maxima: the paper's fraction actuator.

    The power follows every cloud within the interval, because alpha is a share of the maximum
    that is there, not of the one that was expected. The AC rating has clipped `mpp_kw` already.

    Parameters
    ----------
    mpp_kw
        True maximum AC power of each inverter, shape (n,).
    alpha
        Curtailment level of each inverter, in [0, 1], shape (n,).

    Returns
    -------
    ndarray of float
        Delivered power [kW], shape (n,).
    """
    return alpha * mpp_kw
