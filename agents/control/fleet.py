"""A plant of a fleet, as the fleet's central controller sees it: at its own meter."""

from __future__ import annotations

from agents.control.grid import GridLaw, net_kw
from agents.control.storage import Ability


def feedable_kw(power_kw: float, law: GridLaw) -> float:
    """Return what a plant may feed in of what its inverters and storages could give [kW]."""
    return max(min(net_kw(power_kw, law), law.pmax_kw), 0.0)


def feedable_ability(impp_kw: float, able: Ability, law: GridLaw) -> Ability:
    """Return what a plant's storages can add to that, and take."""
    with_storages_kw = feedable_kw(impp_kw + able.discharge_kw, law)
    discharge_kw = with_storages_kw - feedable_kw(impp_kw, law)
    return Ability(discharge_kw, able.absorb_kw, able.charge_kw)
