"""What a grid asks of a plant: ramp limits, frequency response, and power net of its losses.

Names and order of the limits are those of the active-power path of WECC's plant controller model
REPC_A: deadband (`fdbd1`, `fdbd2`), droop (`Ddn`, `Dup`), then `Pmin` and `Pmax`. docs/grid.md has
the formula.
"""

from __future__ import annotations

from math import inf, isnan, sqrt
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Power = TypeVar("Power", float, NDArray[np.float64])


class GridLaw(NamedTuple):
    """What is asked of a plant, by its rating and its cycle. By default nothing is.

    ramp_up_kw, ramp_down_kw: Largest change of the reference in a cycle [kW].
    nominal_hz: Nominal frequency [Hz].
    fdbd1, fdbd2: Ends of the deadband of the frequency error, per unit of the nominal frequency;
        `fdbd1` is that of frequencies above it, and 0 or less.
    ddn_kw, dup_kw: Reciprocal droop above and below the nominal frequency [kW per unit].
    reserve_kw: Headroom that is kept for frequencies below the nominal one [kW].
    pmin_kw, pmax_kw: Limits of the plant's power [kW].
    loss_kw, loss_per_kw: Losses between inverters and meter: constant [kW], and of the square of
        the power [1/kW].
    """

    ramp_up_kw: float = inf
    ramp_down_kw: float = inf
    nominal_hz: float = 60.0
    fdbd1: float = 0.0
    fdbd2: float = 0.0
    ddn_kw: float = 0.0
    dup_kw: float = 0.0
    reserve_kw: float = 0.0
    pmin_kw: float = 0.0
    pmax_kw: float = inf
    loss_kw: float = 0.0
    loss_per_kw: float = 0.0


def net_kw(power_kw: Power, law: GridLaw) -> Power:
    """Return what is left at the meter of the power of all inverters, a number or many [kW]."""
    return power_kw - (law.loss_kw + law.loss_per_kw * power_kw * power_kw)


def gross_kw(net_kw: float, law: GridLaw) -> float:
    """Return the power of all inverters that a power at the meter needs [kW]."""
    if law.loss_per_kw == 0.0:
        return net_kw + law.loss_kw
    root = sqrt(max(1.0 - 4.0 * law.loss_per_kw * (net_kw + law.loss_kw), 0.0))
    return (1.0 - root) / (2.0 * law.loss_per_kw)


def ramped_kw(last_kw: float, dispatch_kw: float, law: GridLaw) -> float:
    """Return the reference: the dispatch, as far as the ramp limits let it go in a cycle [kW].

    `last_kw` is that of the last cycle; NaN: there was none, and the plant begins at the dispatch.
    """
    if isnan(last_kw):
        return dispatch_kw
    return min(max(dispatch_kw, last_kw - law.ramp_down_kw), last_kw + law.ramp_up_kw)


def response_kw(frequency_hz: float, law: GridLaw) -> float:
    """Return the response that the droop asks for at a frequency [kW]; 0 where it is NaN.

    Only the error beyond the deadband counts, so that the response begins without a step. It goes
    up by the reserve at most.
    """
    error = (law.nominal_hz - frequency_hz) / law.nominal_hz
    if error > law.fdbd2:
        return min(law.dup_kw * (error - law.fdbd2), law.reserve_kw)
    if error < law.fdbd1:
        return law.ddn_kw * (error - law.fdbd1)
    return 0.0


def desired_kw(reference_kw: float, response_kw: float, possible_kw: float, law: GridLaw) -> float:
    """Return the power that the plant is to give at its meter [kW].

    Before the response the reserve is taken off the most that is possible; after it come the limits
    of the plant's power. What clouds do to the reserve is no ramp of the plant's own, so its
    ramp limits do not slow it down.
    """
    if law.reserve_kw > 0.0:
        most_kw = min(possible_kw, law.pmax_kw) - law.reserve_kw
        reference_kw = min(reference_kw, max(most_kw, 0.0))
    return min(max(reference_kw + response_kw, law.pmin_kw), law.pmax_kw)
