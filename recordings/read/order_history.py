"""How the order in force changed in a run, by its dispatches."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter

from bus_schemas.messages import Dispatch
from sim_plant.orders import order_of


class OrderHistory:
    """Takes in dispatches in any order; tells with which of them the order changed."""

    def __init__(self) -> None:
        self._last: Dispatch | None = None
        self._kept: list[Dispatch] = []

    def see(self, dispatch: Dispatch) -> None:
        """Keep a dispatch unless it follows the last one and repeats its order."""
        last, self._last = self._last, dispatch
        follows = last is not None and 0 <= dispatch.cycle - last.cycle <= 1
        if last is None or not follows or order_of(last) != order_of(dispatch):
            self._kept.append(dispatch)

    def changes(self) -> list[Dispatch]:
        """Return the first dispatch, and each with which another order is in force, or none."""
        self._kept.sort(key=attrgetter("cycle"))
        return [next(group) for _, group in groupby(self._kept, key=order_of)]
