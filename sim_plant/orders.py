"""What the operator wants from the plant, cycle by cycle: the schedule, or what an order asks for.

The newest order that is accepted counts, whatever its source. The dispatch states it, so that a
recording tells all that the plant went by: the next dispatch follows from the last one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from agents.control.share import usable_dispatch_kw
from agents.plan import RunPlan
from bus_schemas.errors import listed
from bus_schemas.messages import Dispatch, Order, Stamp
from bus_schemas.tree import OPERATOR, PLANT, ROOT
from sim_plant import Floats
from sim_plant.profile import Profile

SCENARIO: Final = "scenario"
"""Source of the orders that a scenario states."""

COMMAND: Final = "command"
PAGE: Final = "page"
MODBUS: Final = "modbus"

GIVERS: Final = {
    SCENARIO: "the scenario",
    COMMAND: "`heliarch order`",
    PAGE: "the page",
    MODBUS: "the Modbus unit",
    OPERATOR: "the operator's program",
}
"""What people call the sources of orders."""

BEFORE_RUN: Final[Stamp] = (-1, 0, PLANT, (), 0, 0, 0, 0)
"""The head of the dispatch with which the plant begins; it is not published."""

_ASKED: Final = ("source", "power_kw", "ramp_kw_per_min", "hold_s", "renew_s")
"""Fields of an order; a dispatch states them with `order_` before them."""

_KEPT: Final = tuple(
    name
    for name in Dispatch.__struct_fields__
    if name.startswith("order_") and name != "order_replaced"
)
"""The fields of a dispatch about its order that the next dispatch repeats."""


def is_ordered(dispatch: Dispatch) -> bool:
    """Whether an order holds, and not the schedule."""
    return dispatch.order_power_kw is not None and dispatch.order_state != "over"


def target_kw(dispatch: Dispatch) -> float:
    """Return where a dispatch goes, maybe by a ramp: the power of its order, or the schedule's."""
    if dispatch.order_power_kw is not None and is_ordered(dispatch):
        return usable_dispatch_kw(dispatch.order_power_kw, dispatch.plant_rating_kw)
    return dispatch.commitment_kw + dispatch.regulation_kw


def order_of(dispatch: Dispatch) -> tuple[str, int, str]:
    """Return what tells an order from another one, and from itself in another state."""
    return dispatch.order_source, dispatch.order_cycle, dispatch.order_state


def order_text(dispatch: Dispatch) -> str:
    """Say what the newest order asks for, or what became of it."""
    if dispatch.order_state == "over":
        return "its order is over: back to the schedule"
    if dispatch.order_state == "silent":
        return "silent: its order is not renewed"
    power_kw, ramp = dispatch.order_power_kw, dispatch.order_ramp_kw_per_min
    asked = "the schedule back" if power_kw is None else f"{power_kw:,.10g} kW"
    if power_kw is not None and power_kw != target_kw(dispatch):
        asked += f", clamped to 0 to {dispatch.plant_rating_kw:,.10g} kW"
    return f"orders {asked}" + ("" if ramp is None else f", {ramp:,.10g} kW/min")


def replaced_text(dispatch: Dispatch) -> str:
    """Name the orders that never came into force because of the one of a dispatch; or nothing."""
    givers = [GIVERS.get(source, source) for source in dispatch.order_replaced]
    return f", in place of {listed(givers)} in the same cycle" if givers else ""


def order_event(dispatch: Dispatch, last: Dispatch | None) -> tuple[str, str] | None:
    """Return source and text of an order that is new, silent or over since the last dispatch.

    Also of one that only renews the last order, if another order gave way to it.
    """
    source, began, state = order_of(dispatch)
    if dispatch.order_replaced:
        return source, order_text(dispatch) + replaced_text(dispatch)
    source_before, _, state_before = order_of(last) if last is not None else ("", 0, "none")
    if not source or (last is not None and order_of(last) == order_of(dispatch)):
        return None
    if not source_before and began != dispatch.cycle:
        return None  # It came into force before the first dispatch that is looked at.
    is_signal = dispatch.order_renew_s is not None  # An order every few seconds.
    if is_signal and state == state_before == "holds" and source == source_before:
        return None
    return source, order_text(dispatch)


class Orders:
    """The orders of a run: those that its scenario states, and those given meanwhile."""

    def __init__(self, plan: RunPlan) -> None:
        self._cycle_s, self._rating_kw = plan.timing.cycle_s, plan.tree.rating_kw(ROOT)
        self._planned = {
            one.cycle(self._cycle_s): Order(
                *(0, 0, SCENARIO, ()),
                power_kw=one.power_kw,
                ramp_kw_per_min=one.ramp_kw_per_min,
                hold_s=one.hold_s,
            )
            for one in plan.orders
        }

    def scheduled(
        self,
        stamp: Stamp,
        commitment_kw: float,
        regulation_kw: float,
        clear_sky_kw: float | None = None,
    ) -> Dispatch:
        return Dispatch(
            *stamp,
            power_kw=commitment_kw + regulation_kw,
            plant_rating_kw=self._rating_kw,
            commitment_kw=commitment_kw,
            regulation_kw=regulation_kw,
            clear_sky_kw=clear_sky_kw,
        )

    def next(self, last: Dispatch, given: Sequence[Order], scheduled: Dispatch) -> Dispatch:
        """Return the dispatch of a cycle: what is `scheduled`, or what an order makes of it.

        The last one is of an earlier cycle: a plant may have missed some. `given` are the orders
        that came since, in the order of time. The newest one counts, and one that was given counts
        more than one of the scenario; the dispatch names the sources of the others.
        """
        cycle = scheduled.cycle
        passed = range(cycle, max(last.cycle, -1), -1)  # None in an arming round.
        planned = [self._planned[of] for of in reversed(passed) if of in self._planned]
        queue = [*planned, *given]
        asked = _accepted(queue, last, cycle) if queue else self._aged(last, cycle)
        dispatch = replace(scheduled, **asked)
        power_kw = aim_kw = target_kw(dispatch)
        ramp = dispatch.order_ramp_kw_per_min
        is_scheduled = not is_ordered(last) and last.power_kw == target_kw(last)
        if ramp is not None and (is_ordered(dispatch) or not is_scheduled):
            step_kw = ramp * len(passed) * self._cycle_s / 60.0
            power_kw = min(max(aim_kw, last.power_kw - step_kw), last.power_kw + step_kw)
        if is_ordered(dispatch) or power_kw != aim_kw:
            dispatch.regulation_kw = 0.0
        dispatch.power_kw = power_kw
        return dispatch

    def _aged(self, last: Dispatch, cycle: int) -> dict[str, Any]:
        """Return the fields that state an order if none came, or a like one, since the last."""
        stated = {name: getattr(last, name) for name in _KEPT}
        age_s = (cycle - last.order_renewed) * self._cycle_s
        if is_ordered(last):
            if last.order_hold_s is not None and age_s >= last.order_hold_s:
                stated["order_state"] = "over"
            elif last.order_renew_s is not None and age_s > last.order_renew_s:
                stated["order_state"] = "silent"
        return stated


def _accepted(queue: Sequence[Order], last: Dispatch, cycle: int) -> dict[str, Any]:
    """Return the fields that state the last order of a queue; one like the last one renews that."""
    *others, order = queue
    asked = {f"order_{name}": getattr(order, name) for name in _ASKED}
    is_renewal = last.order_state in {"holds", "silent"} and all(
        getattr(last, name) == value for name, value in asked.items()
    )
    began = last.order_cycle if is_renewal else cycle
    return {
        **asked,
        "order_state": "holds",
        "order_cycle": began,
        "order_renewed": cycle,
        "order_replaced": tuple(dict.fromkeys(other.source for other in others)),
    }


class Planned(NamedTuple):
    """What is wanted in each cycle of a run, if no order is given meanwhile, shape (T,)."""

    dispatch_kw: Floats
    regulation_kw: Floats


def planned(plan: RunPlan, profile: Profile) -> Planned:
    scheduled_kw = profile.commitment_kw + profile.regulation_kw
    if not plan.orders:
        return Planned(scheduled_kw, profile.regulation_kw)
    orders, found = Orders(plan), []
    last = orders.scheduled(BEFORE_RUN, float(scheduled_kw[0]), 0.0)
    schedule = zip(profile.commitment_kw.tolist(), profile.regulation_kw.tolist(), strict=True)
    for cycle, (commitment_kw, regulation_kw) in enumerate(schedule):
        scheduled = orders.scheduled((cycle, *BEFORE_RUN[1:]), commitment_kw, regulation_kw)
        last = orders.next(last, (), scheduled)
        found.append((last.power_kw, last.regulation_kw))
    return Planned(*np.array(found).T)


def orders_given(dispatch: Dispatch) -> tuple[Order, ...]:
    """Return orders that make a plant send a dispatch, if it is given them."""
    is_given = dispatch.order_source not in {"", SCENARIO}
    if not is_given or dispatch.order_renewed != dispatch.cycle:
        return ()
    asked = {name: getattr(dispatch, f"order_{name}") for name in _ASKED}
    others = [source for source in dispatch.order_replaced if source != SCENARIO]
    return (*(Order(0, 0, source, ()) for source in others), Order(0, 0, missing=(), **asked))
