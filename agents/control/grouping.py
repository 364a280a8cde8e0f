"""Grouping control, for comparison: a reference group at full power shows what others could give.

A part of the inverters, the reference group R, is never curtailed. Its power, scaled by capacity,
is taken for the plant's potential; the others get one common curtailment level, or the power limit
that it leads to, so that both groups together meet the target (V. Gevorgian, "Highly accurate
method for real-time active power reserve estimation for utility-scale photovoltaic power plants",
NREL/TP-5D00-73207, 2019). The plant cannot go below what the reference group gives.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def grouping_levels(
    reference_kw: NDArray[np.float64],
    dispatch_kw: NDArray[np.float64],
    rating_kw: NDArray[np.float64],
    reference: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the curtailment level of each inverter in each cycle.

    With PHL the potential high limit, R the reference group and c the AC ratings::

        PHL = (sum of all c / sum of c over R) x sum of P over R
        alpha = (dispatch - sum of P over R) / (PHL - sum of P over R), within [0, 1]

    Parameters
    ----------
    reference_kw
        Measured power of the reference group in the interval before, shape (T,).
    dispatch_kw
        Dispatch of the plant, shape (T,).
    rating_kw
        AC rating of each inverter, shape (n,).
    reference
        Which inverters are the reference group, shape (n,); at least one, and not all.

    Returns
    -------
    ndarray of float
        Shape (T, n); 1 for the reference group, and for all while it gives nothing.
    """
    others_kw = reference_kw * (rating_kw[~reference].sum() / rating_kw[reference].sum())
    level = np.ones_like(others_kw)
    np.divide(dispatch_kw - reference_kw, others_kw, out=level, where=others_kw > 0.0)
    return np.where(reference, 1.0, level.clip(0.0, 1.0)[:, None])


def grouping_limits_kw(
    reference_kw: NDArray[np.float64],
    dispatch_kw: NDArray[np.float64],
    rating_kw: NDArray[np.float64],
    reference: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the power limit of each inverter, see `grouping_levels`; infinite for the reference.

    It is alpha times the power that the reference group promises for the inverter's rating.
    """
    levels = grouping_levels(reference_kw, dispatch_kw, rating_kw, reference)
    promised_kw = np.outer(reference_kw / rating_kw[reference].sum(), rating_kw)
    return np.where(reference, np.inf, levels * promised_kw)
