"""What the dispatch asks of one node: every controller hears it and works this out for itself."""

from __future__ import annotations

from agents.control.request import request_kw
from bus_schemas.messages import Dispatch


def usable_kw(dispatch: Dispatch) -> float:
    """Return the dispatch within what the plant can be asked for: 0 to its rating [kW]."""
    return min(max(dispatch.power_kw, 0.0), dispatch.plant_rating_kw)


def own_request_kw(dispatch: Dispatch | None, rating_kw: float) -> float | None:
    """Return a node's request (eq. 3) [kW], None where no dispatch is heard or it has no rating."""
    if dispatch is None or dispatch.plant_rating_kw == 0.0:
        return None
    return request_kw(usable_kw(dispatch), rating_kw, dispatch.plant_rating_kw)
