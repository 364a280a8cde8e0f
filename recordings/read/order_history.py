"""How the order in force changed in a run, by its dispatches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

from bus_schemas.messages import Dispatch
from sim_plant.orders import order_of


@dataclass
class _Span:
    """Cycles that follow each other with the same order in force."""

    first: Dispatch
    last_cycle: int


class OrderHistory:
    """Takes in dispatches in any order; tells with which of them the order changed."""

    def __init__(self) -> None:
        self._spans: list[_Span] = []

    def see(self, dispatch: Dispatch) -> None:
        if self._spans:
            span = self._spans[-1]
            is_same = order_of(dispatch) == order_of(span.first)
            if is_same and 0 <= dispatch.cycle - span.last_cycle <= 1:
                span.last_cycle = dispatch.cycle
                return
        self._spans.append(_Span(dispatch, dispatch.cycle))

    def changes(self) -> list[Dispatch]:
        """Return the first dispatch, and each with which another order is in force, or none."""
        self._spans.sort(key=lambda span: span.first.cycle)
        joined = self._spans[:1]
        for span in self._spans[1:]:
            before = joined[-1]
            is_same = order_of(before.first) == order_of(span.first)
            if is_same and span.first.cycle <= before.last_cycle + 1:
                before.last_cycle = max(before.last_cycle, span.last_cycle)
            else:
                joined.append(span)
        self._spans = joined
        groups = groupby((span.first for span in joined), key=order_of)
        return [next(group) for _, group in groups]
