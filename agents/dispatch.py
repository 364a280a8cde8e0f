"""A node's request, which every controller works out from the dispatch."""

from __future__ import annotations

from agents.control.request import request_kw, usable_dispatch_kw
from bus_schemas.messages import Dispatch


def own_request_kw(dispatch: Dispatch | None, rating_kw: float) -> float | None:
    """Return a node's request (eq. 3) [kW], None where no dispatch is heard or it has no rating."""
    if dispatch is None or dispatch.plant_rating_kw == 0.0:
        return None
    plant_rating_kw = dispatch.plant_rating_kw
    usable_kw = usable_dispatch_kw(dispatch.power_kw, plant_rating_kw)
    return request_kw(usable_kw, rating_kw, plant_rating_kw)
