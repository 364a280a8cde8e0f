"""What the operator wants, cycle by cycle, from orders worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from plans_by_hand import plan_of

from agents.loop import Loop
from agents.plan import RunPlan
from agents.plan_file import check_plan
from agents.plan_parts import PlannedOrder
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Order
from bus_schemas.signals import DISPATCH, ORDER
from bus_schemas.tree import OPERATOR, ROOT
from sim_plant.orders import BEFORE_RUN, Orders, is_ordered, orders_given, planned
from sim_plant.plant import Plant
from sim_plant.profile import Profile

SCHEDULED_KW = 100.0
RATING_KW = 200.0


def order(power_kw: float | None = None, source: str = "command", **fields: Any) -> Order:
    return Order(0, 0, source, (), power_kw=power_kw, **fields)


def after(last: Dispatch | None, cycle: int, given: Sequence[Order], plan: RunPlan) -> Dispatch:
    """The dispatch of a cycle, where the schedule is 100 kW of commitment."""
    orders = Orders(plan)
    last = last or orders.scheduled(BEFORE_RUN, SCHEDULED_KW, 0.0)
    scheduled = orders.scheduled((cycle, *BEFORE_RUN[1:]), SCHEDULED_KW, 0.0)
    return orders.next(last, given, scheduled)


def dispatched(
    given: dict[int, Order | list[Order]],
    *of_scenario: PlannedOrder,
    cycles: int = 8,
    cycle_s: float = 1.0,
) -> list[Dispatch]:
    """The dispatch of each cycle, from the orders that the plant finds in some of them."""
    plan = plan_of({"a": RATING_KW}, orders=of_scenario, cycle_ns=round(cycle_s * 1e9))
    found: list[Dispatch] = []
    for cycle in range(cycles):
        now = given.get(cycle, [])
        orders = [now] if isinstance(now, Order) else now
        found.append(after(found[-1] if found else None, cycle, orders, plan))
    return found


def powers_kw(found: list[Dispatch]) -> list[float]:
    return [one.power_kw for one in found]


def states(found: list[Dispatch]) -> list[str]:
    return [one.order_state for one in found]


def test_an_order_holds_until_the_schedule_is_ordered_back() -> None:
    found = dispatched({2: order(50.0), 5: order()})
    assert powers_kw(found) == [100.0, 100.0, 50.0, 50.0, 50.0, 100.0, 100.0, 100.0]
    assert [is_ordered(one) for one in found] == [False] * 2 + [True] * 3 + [False] * 3


def test_the_dispatch_ramps_to_an_order_and_back_and_then_follows_the_schedule_at_once() -> None:
    ramp: dict[str, Any] = {"ramp_kw_per_min": 60.0 * 20.0}
    found = dispatched({1: order(50.0, **ramp), 5: order(**ramp)}, cycles=10)
    assert powers_kw(found) == [100.0, 80.0, 60.0, 50.0, 50.0, 70.0, 90.0, 100.0, 100.0, 100.0]
    orders = Orders(plan_of({"a": RATING_KW}))
    scheduled = orders.scheduled((10, *BEFORE_RUN[1:]), 180.0, 0.0)
    assert orders.next(found[-1], (), scheduled).power_kw == 180.0


def test_the_newest_order_wins_whatever_its_source() -> None:
    at_three = PlannedOrder(at=3.0, power_kw=30.0)
    found = dispatched({1: order(10.0), 2: order(20.0, "modbus"), 5: order(40.0, "page")}, at_three)
    assert powers_kw(found) == [100.0, 10.0, 20.0, 30.0, 30.0, 40.0, 40.0, 40.0]
    sources = [one.order_source for one in found]
    assert sources == ["", "command", "modbus", "scenario", "scenario", "page", "page", "page"]


def test_the_orders_that_a_dispatch_names_make_the_same_dispatch_again() -> None:
    at_three = PlannedOrder(at=3.0, power_kw=30.0)
    given: dict[int, Order | list[Order]] = {
        1: order(10.0),
        3: [order(10.0, "page"), order(40.0)],
        4: order(40.0),
    }
    found = dispatched(given, at_three)
    plan = plan_of({"a": RATING_KW}, orders=(at_three,))
    for last, dispatch in pairwise(found):
        assert after(last, dispatch.cycle, orders_given(dispatch), plan) == dispatch


def test_an_order_that_is_not_renewed_is_silent_then_over_and_the_schedule_returns() -> None:
    found = dispatched({1: order(50.0, renew_s=2.0, hold_s=4.0)})
    assert states(found) == ["none", "holds", "holds", "holds", "silent", "over", "over", "over"]
    assert powers_kw(found) == [100.0, 50.0, 50.0, 50.0, 50.0, 100.0, 100.0, 100.0]


def test_the_same_order_again_renews_it() -> None:
    agc = order(50.0, renew_s=2.0, hold_s=4.0)
    found = dispatched({1: agc, 4: agc})
    assert states(found) == ["none", "holds", "holds", "holds", "holds", "holds", "holds", "silent"]
    assert (found[-1].order_cycle, found[-1].order_renewed) == (1, 4)


@pytest.mark.parametrize(("asked_kw", "given_kw"), [(-5.0, 0.0), (1e9, RATING_KW)])
def test_an_order_out_of_range_is_clamped_and_recorded_as_it_was_asked(
    asked_kw: float, given_kw: float
) -> None:
    last = dispatched({1: order(asked_kw)})[-1]
    assert last.power_kw == given_kw
    assert last.order_power_kw == asked_kw


def test_a_plant_that_missed_cycles_obeys_the_order_that_they_had() -> None:
    order_at_two = PlannedOrder(at=2.0, power_kw=40.0, ramp_kw_per_min=600.0)
    plan = plan_of({"a": RATING_KW}, orders=(order_at_two,))
    assert after(after(None, 0, (), plan), 3, (), plan).power_kw == 70.0


def test_an_order_at_the_beginning_comes_into_force_in_cycle_0_and_in_no_arming_round() -> None:
    plan = plan_of({"a": RATING_KW}, orders=(PlannedOrder(at=0.0, power_kw=40.0),))
    assert after(None, -999_999, (), plan).power_kw == SCHEDULED_KW
    found = after(None, 0, (), plan)
    assert (found.power_kw, found.order_cycle) == (40.0, 0)


def test_arrays_want_what_the_plant_wants() -> None:
    orders = (PlannedOrder(at=2.0, power_kw=40.0, ramp_kw_per_min=1200.0),)
    plan = plan_of({"a": RATING_KW}, cycles=6, orders=orders)
    profile = Profile(np.full((6, 1), 90.0), np.full(6, SCHEDULED_KW), np.full(6, 10.0), 10.0)
    found = planned(plan, profile)
    assert found.dispatch_kw.tolist() == [110.0, 110.0, 90.0, 70.0, 50.0, 40.0]
    assert found.regulation_kw.tolist() == [10.0, 10.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("orders", "field"),
    [
        ((PlannedOrder(at=1.0, power_kw=201.0),), "orders[0].power_kw"),
        ((PlannedOrder(at=1.0, power_kw=1.0), PlannedOrder(at=1.4, schedule=True)), "orders[1].at"),
    ],
)
def test_orders_that_cannot_be_meant_are_refused(
    orders: tuple[PlannedOrder, ...], field: str
) -> None:
    with pytest.raises(InputError, match=field.replace("[", r"\[")):
        check_plan(plan_of({"a": RATING_KW}, cycles=6, orders=orders))


def dispatch_after(*given: Order, cycle: int = 20) -> Dispatch:
    """The dispatch of a plant that has heard orders since its last one."""
    plan = plan_of({"a": RATING_KW}, cycles=30)
    loop = Loop(Plant(plan, Profile(np.full((30, 1), 90.0), np.full(30, SCHEDULED_KW))), plan)
    loop.begin(0, 0, cycle)
    for one in given:
        loop.hear(ORDER.of(ROOT), one, 0)
    found = dict(loop.close_stage(0) or ())[DISPATCH.of(ROOT)]
    assert isinstance(found, Dispatch)
    return found


def test_an_order_is_part_of_the_next_dispatch_and_the_newest_one_wins() -> None:
    of_operator = [Order(19, 0, OPERATOR, (), power_kw=power_kw) for power_kw in (50.0, 60.0)]
    found = dispatch_after(*of_operator)
    assert (found.power_kw, found.commitment_kw) == (60.0, SCHEDULED_KW)
    assert (found.order_source, found.order_cycle) == (OPERATOR, 20)


@pytest.mark.parametrize(
    "fields",
    [
        {"power_kw": nan},
        {"power_kw": inf},
        {"power_kw": 50.0, "ramp_kw_per_min": 0.0},
        {"power_kw": 50.0, "hold_s": -1.0},
        {"power_kw": 50.0, "cycle": 3},  # It was long on its way.
        {"power_kw": 50.0, "source": "c1"},
    ],
)
def test_an_order_that_cannot_be_is_not_obeyed(fields: dict[str, Any]) -> None:
    found = dispatch_after(replace(Order(19, 0, OPERATOR, (), power_kw=50.0), **fields))
    assert (found.power_kw, found.order_source) == (SCHEDULED_KW, "")
