"""The central controller: it corrects its target by the plant's meter, and clamps the dispatch."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, meter, report

from bus_schemas.messages import Notice, Setpoint
from bus_schemas.signals import DISPATCH, NOTICE, RESIDUAL, SETPOINT
from bus_schemas.tree import ROOT

CORRECTING = plan_of({"a": 100.0, "b": 100.0}, cycles=300, correction=True, cycle_wall_ns=REAL_TIME)
"""Two inverters below a central controller that corrects, by the clock."""


@pytest.mark.parametrize("absurd_kw", [math.nan, math.inf, -math.inf, -100.0, 1e9])
def test_an_absurd_meter_leaves_no_trace(absurd_kw: float) -> None:
    central = AtWork(CORRECTING, "central")
    for cycle, metered_kw in enumerate((50.0, absurd_kw)):
        cycle_with_meter(central, cycle, metered_kw)
    assert cycle_with_meter(central, 2, 50.0) == pytest.approx(50.0)
    assert central.loop.inputs.dropped == {("meter", "out_of_range"): 1}


def test_the_aim_is_the_dispatch_plus_offset_and_mean_error() -> None:
    control = replace(CORRECTING.control, correction=False, offset_kw=3.0, offset_errors=2.0)
    central = AtWork(replace(CORRECTING, control=control), "central")
    assert cycle_with_meter(central, 0, 50.0) == pytest.approx(53.0)
    assert cycle_with_meter(central, 1, 53.0) == pytest.approx(53.0)
    # 8.4 kW were missing of 53: 1/21 of that enters the mean over 20 s.
    assert cycle_with_meter(central, 2, 44.6) == pytest.approx(53.0 + 2.0 * 8.4 / 21.0)


def cycle_with_meter(
    central: AtWork, cycle: int, metered_kw: float | None, impp_kw: float = 80.0
) -> float:
    """Let a cycle go by in which 50 kW are dispatched; return what is set in all."""
    residual_kw = impp_kw - 25.0
    reports = report("a", cycle, impp_kw, residual_kw) + report("b", cycle, impp_kw, residual_kw)
    sent = central.hear(dispatch(cycle, 50.0, 200.0), *reports)
    if metered_kw is None:
        sent |= central.at_deadline("solve")
    else:
        sent |= central.hear(meter(cycle, metered_kw))
    return sum(message.power_kw for message in sent.values() if isinstance(message, Setpoint))


# The dispatch -------------------------------------------------------------------------------------

FLOOR_KW = 0.05 * 300.0
"""What `b` gives at least: an inverter is not curtailed further."""

PLAN = plan_of({"a": 100.0, "b": 300.0}, cycles=100, cycle_wall_ns=REAL_TIME)


def set_and_noticed(*dispatches_kw: float) -> tuple[list[float], list[int]]:
    """What is set of `b`, which has 3/4 of the rating, and what is noticed, for each one."""
    central = AtWork(PLAN, "central")
    set_kw: list[float] = []
    counts: list[int] = []
    for cycle, power_kw in enumerate(dispatches_kw):
        sent = central.hear(
            dispatch(cycle, power_kw, 400.0),
            meter(cycle, 0.0),
            *report("a", cycle, 100.0, 0.0),
            *report("b", cycle, 300.0, 0.0),
        )
        set_kw.append(at(sent, SETPOINT.of("b")).power_kw)
        notice = sent.get(NOTICE.of(ROOT))
        if isinstance(notice, Notice):
            counts.append(notice.count)
    return set_kw, counts


def test_clamped_dispatches_are_counted_together() -> None:
    set_kw, counts = set_and_noticed(100.0, -1.0, 500.0, 200.0)
    assert set_kw == [75.0, FLOOR_KW, 300.0, 150.0]
    assert counts == [1, 2]


@pytest.mark.parametrize("rating_kw", [0.0, -400.0, math.nan, math.inf, 0.4, 400_000.0, 399.0])
def test_a_dispatch_with_another_rating_than_the_plans_is_not_used(rating_kw: float) -> None:
    central = AtWork(PLAN, "central")
    central.hear(dispatch(0, 200.0, rating_kw), meter(0, 0.0))
    central.hear(*report("a", 0, 100.0, 0.0))
    central.at_deadline("solve")
    assert central.loop.inputs.dropped == {(str(DISPATCH.of(ROOT)), "out_of_range"): 1}


def test_before_the_first_dispatch_nothing_is_set_and_nothing_is_lacking() -> None:
    central = AtWork(PLAN, "central")
    central.hear(*report("a", 0, 80.0, 80.0), *report("b", 0, 90.0, 90.0))
    sent = central.at_deadline("solve")
    assert at(sent, RESIDUAL.of(ROOT)).power_kw == 170.0
    assert SETPOINT.of("a") not in sent
