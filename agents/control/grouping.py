"""Grouping control, for comparison: a reference group at full power tells what the rest could give.

A part of the inverters, the reference group R, is never curtailed. Its power, scaled by capacity,
is taken for the plant's potential; the others, the control group, get one uniform power limit so
that both groups together meet the target (V. Gevorgian, "Highly accurate method for real-time
active power reserve estimation for utility-scale photovoltaic power plants", NREL/TP-5D00-73207,
2019). Nothing is redistributed within the control group, and the plant cannot go below what the
reference group gives.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def grouping_limits_kw(
    reference_kw: NDArray[np.float64],
    desired_kw: NDArray[np.float64],
    rating_kw: NDArray[np.float64],
    reference: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the power limit of each inverter in each cycle.

    With PHL the potential high limit, T the target and c the AC ratings::

        PHL = (sum of all c / sum of c over R) x sum of P over R
        T = min(P_desired, PHL)
        P_C = T - sum of P over R, within [0, PHL - sum of P over R]
        limit of i in C = P_C x c_i / sum of c over C

    Parameters
    ----------
    reference_kw
        Measured power of the reference group in the interval before, shape (T,).
    desired_kw
        Power wanted from the plant, shape (T,).
    rating_kw
        AC rating of each inverter, shape (n,).
    reference
        Which inverters are the reference group, shape (n,); at least one, and not all.

    Returns
    -------
    ndarray of float
        Shape (T, n); infinite for the reference group.

    Raises
    ------
    ValueError
        The reference group is empty or the whole plant.
    """
    if not reference.any() or reference.all():
        raise ValueError(f"a reference group of 1 to {len(reference) - 1} inverters is needed")
    potential_kw = rating_kw.sum() / rating_kw[reference].sum() * reference_kw
    wanted_kw = np.minimum(desired_kw, potential_kw) - reference_kw
    control_kw = np.clip(wanted_kw, 0.0, potential_kw - reference_kw)
    share = rating_kw / rating_kw[~reference].sum()
    return np.where(reference, np.inf, control_kw[:, None] * share)
