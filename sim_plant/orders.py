"""What the operator wants from the plant, cycle by cycle: the schedule, or what an order asks for.

The newest order that is accepted counts, whatever its source. It is part of the dispatch, so that a
recording tells all that the plant went by.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import asdict, replace

from agents.control.share import usable_dispatch_kw
from agents.plan import PlannedOrder, RunPlan
from bus_schemas.messages import Dispatch, Order, OrderState
from bus_schemas.tree import ROOT
from sim_plant import Floats
from sim_plant.profile import Profile

SCENARIO: Final = "scenario"
"""Source of the orders that a scenario states."""


class OrderInForce(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """The newest order that the plant has accepted: see the fields `order_...` of `Dispatch`."""

    source: str
    state: OrderState = "holds"
    cycle: int
    renewed: int
    power_kw: float | None
    ramp_kw_per_min: float | None
    hold_s: float | None
    renew_s: float | None

    @classmethod
    def by(cls, dispatch: Dispatch) -> OrderInForce | None:
        """Return the order that a dispatch states, if it states one."""
        if not dispatch.order_source:
            return None
        names = cls.__struct_fields__
        return cls(**{name: getattr(dispatch, f"order_{name}") for name in names})

    @property
    def what(self) -> tuple[object, ...]:
        """What tells it from another order, and from itself in another state."""
        return self.source, self.cycle, self.state

    def text(self, rating_kw: float) -> str:
        """Say what it asks for, and what became of it."""
        if self.state == "over":
            return "its order is over: back to the schedule"
        if self.state == "silent":
            return "silent: its order is not renewed"
        ramp = "" if self.ramp_kw_per_min is None else f", {self.ramp_kw_per_min:,.10g} kW/min"
        if self.power_kw is None:
            return f"orders the schedule back{ramp}"
        is_within = 0.0 <= self.power_kw <= rating_kw
        clamped = "" if is_within else f", clamped to 0 to {rating_kw:,.10g} kW"
        return f"orders {self.power_kw:,.10g} kW{clamped}{ramp}"

    def stated(self) -> dict[str, Any]:
        """Return the fields of a dispatch that state it."""
        return {f"order_{name}": value for name, value in asdict(self).items()}


class OrderEvents:
    """What became of the orders of a run, dispatch by dispatch."""

    def __init__(self, rating_kw: float) -> None:
        self._rating_kw = rating_kw
        self._last: OrderInForce | None = None

    def see(self, dispatch: Dispatch) -> tuple[str, str] | None:
        """Return source and text of a new order, and of one that is silent or over."""
        order, last = OrderInForce.by(dispatch), self._last
        self._last = order
        if order is None or (last is not None and order.what == last.what):
            return None
        if last is None and order.cycle != dispatch.cycle:
            return None  # It came into force before the first dispatch that is looked at.
        goes_on = last is not None and (last.source, last.state) == (order.source, "holds")
        if goes_on and order.state == "holds" and order.renew_s is not None:
            return None  # A signal: an order every few seconds.
        return order.source, order.text(self._rating_kw)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the operator wanted in the last cycle.

    order: The newest order.
    power_kw: The power that the plant was to give.
    is_scheduled: Whether that was what the schedule asked for.
    is_there: Whether it was what the order, or the schedule, asks for, and not a step of a ramp.
    """

    power_kw: float
    order: OrderInForce | None = None
    is_scheduled: bool = True
    cycle: int = -1
    is_there: bool = True

    @classmethod
    def by(cls, dispatch: Dispatch) -> Wanted:
        """Return what a dispatch says."""
        scheduled_kw = dispatch.commitment_kw + dispatch.regulation_kw
        is_scheduled = dispatch.power_kw == scheduled_kw
        return cls(dispatch.power_kw, OrderInForce.by(dispatch), is_scheduled, dispatch.cycle)


class Orders:
    """The orders of a run: those that its scenario states, and those given meanwhile."""

    def __init__(self, planned: Iterable[PlannedOrder], cycle_s: float, rating_kw: float) -> None:
        self._cycle_s, self._rating_kw = cycle_s, rating_kw
        self._planned = {order.cycle(cycle_s): order for order in planned}

    def next(self, last: Wanted, given: Order | None, scheduled_kw: float, cycle: int) -> Wanted:
        """Return what is wanted in a cycle, from the last one and an order given since."""
        order = last.order
        missed = range(max(cycle, 0), max(last.cycle, -1), -1)  # A plant may have missed cycles.
        planned = next((self._planned[of] for of in missed if of in self._planned), None)
        if planned is not None:
            order = _accepted(planned, SCENARIO, None, order, cycle)
        elif given is not None:
            order = _accepted(given, given.source, given.renew_s, order, cycle)
        elif order is not None:
            order = self._aged(order, cycle)
        return self._wanted(last, order, scheduled_kw, cycle, len(missed))

    def _aged(self, order: OrderInForce, cycle: int) -> OrderInForce:
        age_s = (cycle - order.renewed) * self._cycle_s
        if order.power_kw is None or order.state == "over":
            return order
        if order.hold_s is not None and age_s >= order.hold_s:
            return replace(order, state="over")
        if order.renew_s is not None and age_s > order.renew_s:
            return replace(order, state="silent")
        return order

    def _wanted(
        self, last: Wanted, order: OrderInForce | None, scheduled_kw: float, cycle: int, passed: int
    ) -> Wanted:
        """Return what is wanted in a cycle, so many cycles after the last one."""
        power_kw = target_kw = scheduled_kw
        is_ordered = order is not None and order.power_kw is not None and order.state != "over"
        if order is not None and (is_ordered or not last.is_scheduled):
            if is_ordered and order.power_kw is not None:
                target_kw = usable_dispatch_kw(order.power_kw, self._rating_kw)
            power_kw = target_kw
            if order.ramp_kw_per_min is not None:
                step_kw = order.ramp_kw_per_min * passed * self._cycle_s / 60.0
                power_kw = min(max(target_kw, last.power_kw - step_kw), last.power_kw + step_kw)
        is_there = power_kw == target_kw
        return Wanted(power_kw, order, is_there and not is_ordered, cycle, is_there)


def _accepted(
    given: Order | PlannedOrder,
    source: str,
    renew_s: float | None,
    last: OrderInForce | None,
    cycle: int,
) -> OrderInForce:
    """Return an order as it comes into force; one like the last one renews that."""
    order = OrderInForce(
        source=source,
        cycle=cycle,
        renewed=cycle,
        power_kw=given.power_kw,
        ramp_kw_per_min=given.ramp_kw_per_min,
        hold_s=given.hold_s,
        renew_s=renew_s,
    )
    if last is not None and last.state != "over":
        renewed = replace(order, cycle=last.cycle)
        if replace(last, state="holds", renewed=cycle) == renewed:
            return renewed
    return order


class Planned(NamedTuple):
    """What is wanted in each cycle of a run, if no order is given meanwhile, shape (T,)."""

    dispatch_kw: Floats
    regulation_kw: Floats


def planned(plan: RunPlan, profile: Profile) -> Planned:
    scheduled_kw = profile.commitment_kw + profile.regulation_kw
    if not plan.orders:
        return Planned(scheduled_kw, profile.regulation_kw)
    orders = Orders(plan.orders, plan.timing.cycle_s, plan.tree.rating_kw(ROOT))
    wanted = [Wanted(float(scheduled_kw[0]))]
    for cycle, power_kw in enumerate(scheduled_kw.tolist()):
        wanted.append(orders.next(wanted[-1], None, power_kw, cycle))
    return Planned(
        np.array([one.power_kw for one in wanted[1:]]),
        np.where([one.is_scheduled for one in wanted[1:]], profile.regulation_kw, 0.0),
    )


def order_given(dispatch: Dispatch) -> Order | None:
    """Return the order that a plant must have been given to send a dispatch; None: none."""
    order = OrderInForce.by(dispatch)
    if order is None or order.renewed != dispatch.cycle or order.source == SCENARIO:
        return None
    return Order(
        dispatch.cycle,
        dispatch.sim_time_ns,
        order.source,
        (),
        power_kw=order.power_kw,
        ramp_kw_per_min=order.ramp_kw_per_min,
        hold_s=order.hold_s,
        renew_s=order.renew_s,
    )
