"""The battery that a plant would have needed to miss nothing: what help between inverters saves."""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

EFFICIENCY: Final = 0.85
"""Of a round trip at the meter, as for lithium-ion plants: Cole and Karmakar, "Cost Projections for
Utility-Scale Battery Storage: 2023 Update", NREL/TP-6A40-85332."""


class Battery(NamedTuple):
    """The smallest battery beside a plant, and what it would have done.

    power_kw: Its largest discharge.
    energy_kwh: The least capacity, of a battery of that power that is full at first.
    cycles: Discharged energy over the capacity; 0 of no battery.
    mileage_kw: Sum of the changes of its power from cycle to cycle.
    """

    power_kw: float
    energy_kwh: float
    cycles: float
    mileage_kw: float


def smallest_battery(
    missing_kw: NDArray[np.float64],
    headroom_kw: NDArray[np.float64],
    cycle_s: float,
    efficiency: float = EFFICIENCY,
) -> Battery:
    """Return the smallest battery that would have given all that was missing.

    It has the least power that can, the largest of what was missing, and with that the least
    capacity. It is full at first, gives what is missing, and is charged from headroom as soon as
    there is any: charging later can only need more capacity. With the charge `d` that it lacks,

        d[k+1] = max(0, d[k] + missing[k] dt / e - min(headroom[k], power) dt e)

    where `e` is the root of the efficiency, and the capacity is the largest `d`.

    Parameters
    ----------
    missing_kw
        Power that was missing in each cycle, shape (T,); NaN counts as unknown: neither charged nor
        discharged.
    headroom_kw
        Power that the inverters had and did not give in each cycle, shape (T,).
    cycle_s
        Length of a cycle [s].
    efficiency
        Of a round trip, in (0, 1].
    """
    missing, headroom = np.nan_to_num(missing_kw), np.nan_to_num(headroom_kw)
    power_kw = float(missing.max(initial=0.0))
    one_way, hours = sqrt(efficiency), cycle_s / 3600.0
    charged_kw = np.where(missing > 0.0, 0.0, np.clip(headroom, 0.0, power_kw))
    changes_kwh = missing * hours / one_way - charged_kw * hours * one_way
    lacks_kwh, lacking_kwh = 0.0, [0.0]
    for change_kwh in changes_kwh.tolist():
        lacks_kwh = max(0.0, lacks_kwh + change_kwh)
        lacking_kwh.append(lacks_kwh)
    capacity_kwh = max(lacking_kwh)
    power = missing - np.minimum(charged_kw, np.array(lacking_kwh[:-1]) / (hours * one_way))
    discharged_kwh = float(missing.sum()) * hours / one_way
    return Battery(
        power_kw,
        capacity_kwh,
        discharged_kwh / capacity_kwh if capacity_kwh else 0.0,
        float(np.abs(np.diff(power, prepend=0.0)).sum()),
    )
