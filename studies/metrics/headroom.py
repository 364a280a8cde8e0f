"""Power that a plant held back, and power that it could have offered beside its commitment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class HeadroomMetrics:
    """What was left of the possible power; dt is the length of a cycle in hours.

    Attributes
    ----------
    headroom_kwh
        Headroom kept: sum max(0, possible - delivered) dt [kWh].
    mean_headroom_kw
        Its mean over the run [kW].
    ancillary_potential_kwh
        Sum max(0, possible - commitment) dt [kWh]: energy that regulation could have used.

        The paper (section IV) calls it the area between the maximum power of the plant and the
        commitment, 6.61 MWh on its day. Whether a time at which the maximum is below the
        commitment counts as negative is left open; here it does not, since a plant has nothing
        to offer then. `possible_kwh` less the energy committed is the other reading.
    """

    headroom_kwh: float
    mean_headroom_kw: float
    ancillary_potential_kwh: float


def headroom_metrics(
    commitment_kw: NDArray[np.float64],
    possible_kw: NDArray[np.float64],
    delivered_kw: NDArray[np.float64],
    cycle_s: float,
) -> HeadroomMetrics:
    """Work out the headroom of a run.

    Parameters
    ----------
    commitment_kw, possible_kw, delivered_kw
        The plant cycle by cycle, shape (T,), T at least 1. The commitment is without regulation.
    cycle_s
        Length of a cycle [s].
    """
    hours = cycle_s / 3600.0
    headroom_kw = np.maximum(possible_kw - delivered_kw, 0.0)
    potential_kw = np.maximum(possible_kw - commitment_kw, 0.0)
    return HeadroomMetrics(
        headroom_kwh=float(headroom_kw.sum()) * hours,
        mean_headroom_kw=float(headroom_kw.mean()),
        ancillary_potential_kwh=float(potential_kw.sum()) * hours,
    )
