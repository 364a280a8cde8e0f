"""The share of a node by the dispatch, and its report."""

from __future__ import annotations

from agents.agent import Turn
from agents.control.share import share_kw, usable_dispatch_kw
from agents.control.storage import Ability
from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Help, Impp, Residual
from bus_schemas.signals import HELP, IMPP, RESIDUAL


def own_share_kw(dispatch: Dispatch | None, rating_kw: float) -> float | None:
    """Return a node's share (eq. 3) [kW]; None where no dispatch is heard."""
    if dispatch is None:
        return None
    plant_rating_kw = dispatch.plant_rating_kw
    usable_kw = usable_dispatch_kw(dispatch.power_kw, plant_rating_kw)
    return share_kw(usable_kw, rating_kw, plant_rating_kw)


def own_report(
    node: str,
    turn: Turn,
    impp_kw: float,
    stale_cycles: int,
    residual_kw: float,
    able: Ability | None = None,
) -> list[Delivery]:
    """Report upwards: IMPP and residual (eq. 4), and a call for help if that is negative.

    able: What the storages below a parent can do.
    """
    impp = Impp(*turn.stamp, power_kw=impp_kw, stale_cycles=stale_cycles)
    if able is not None:
        impp.discharge_kw, impp.absorb_kw, impp.charge_kw = able
    outputs: list[Delivery] = [
        (IMPP.of(node), impp),
        (RESIDUAL.of(node), Residual(*turn.stamp, power_kw=residual_kw)),
    ]
    if residual_kw < 0.0:
        outputs.append((HELP.of(node), Help(*turn.stamp, missing_kw=-residual_kw)))
    return outputs
