"""The plant's answer to an order, followed while it comes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from agents.plan import RunPlan
from bus_schemas.errors import FailureError
from bus_schemas.tree import ROOT
from results.answers import TOLERANCE_PERCENT, Answer, answer
from sim_plant.order_desk import TAKEN, PlantStatus

_REST_S: Final = 10.0
_LONGEST_S: Final = 60.0
"""How long the plant is followed once the dispatch is what was asked for, and the longest time, if
the power does not settle: of simulated time."""


def answer_text(found: Answer) -> str:
    """Say in a line how the plant answered: `2,000 kW reached within 1 % after 3.0 s`."""
    asked = f"{found.to_kw:,.0f} kW"
    if found.settling_s is None:
        sun = "; the sun gave less" if found.unable_percent else ""
        return f"{asked} not reached within {TOLERANCE_PERCENT:g} %{sun}"
    took = f"after {found.ramp_s + found.settling_s:.1f} s"
    ramp = f", {found.ramp_s:.1f} s of them a ramp" if found.ramp_s else ""
    reached = f"{asked} reached within {TOLERANCE_PERCENT:g} % {took}{ramp}"
    return f"{reached}, overshoot {found.overshoot_percent or 0.0:.1f} %"


def watched(statuses: Iterator[PlantStatus], plan: RunPlan) -> tuple[Answer, str]:
    """Follow the plant until it has settled; return its answer, and what ended it early."""
    before, seen, there_s, remark = None, list[PlantStatus](), 0.0, "; the run is over"
    for status in statuses:
        if not seen and status.answer not in {"", TAKEN}:
            raise FailureError(f"order: {status.answer}")
        if not seen and status.answer != TAKEN:
            before = status
            continue
        seen.append(status)
        if _of(status) != _of(seen[0]):
            remark = "; then another order came, or its time was over"
            seen.pop()
            break
        there_s += plan.timing.cycle_s if status.is_there else 0.0
        is_settled = there_s >= _REST_S and _answer(before, seen, plan).settling_s is not None
        if is_settled or there_s >= _LONGEST_S:
            remark = ""
            break
    if not seen:
        raise FailureError("order: the run ended before the plant took it")
    return _answer(before, seen, plan), remark


def _answer(before: PlantStatus | None, seen: list[PlantStatus], plan: RunPlan) -> Answer:
    dispatch_kw, delivered_kw, available_kw = np.array(
        [(one.dispatch_kw, one.delivered_kw, one.available_kw) for one in seen]
    ).T
    from_kw = (before or seen[0]).delivered_kw
    rating_kw = plan.tree.rating_kw(ROOT)
    return answer(dispatch_kw, delivered_kw, available_kw, from_kw, plan.timing.cycle_s, rating_kw)


def _of(status: PlantStatus) -> tuple[object, ...]:
    """Return what tells one order from the next."""
    order = status.order
    return () if order is None else (order.source, order.cycle, order.state == "over")
