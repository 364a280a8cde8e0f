"""The central controller corrects its target by what the plant's meter read: the integral part."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from memory_runs import run_in_memory
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, dispatch, meter, report

from agents.control.correction import HIGHEST_GAIN
from agents.plan import RunPlan
from bus_schemas.messages import Setpoint
from bus_schemas.signals import SETPOINT
from sim_plant.profile import Profile

CYCLES = 60


def test_where_all_there_is_falls_short_nothing_is_added() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=CYCLES, correction=True)
    # Too dark for a while; then there is more than is desired again.
    mpp_kw = np.array([[40.0 if cycle < CYCLES - 2 else 90.0] * 2 for cycle in range(CYCLES)])
    _, heard = run_in_memory(plan, Profile(mpp_kw, np.full(CYCLES, 120.0)))
    last_kw = [heard.of(SETPOINT.of(node))[CYCLES - 1].power_kw for node in ("a", "b")]
    assert sum(last_kw) <= 120.0 + 1e-9


@pytest.mark.parametrize("absurd_kw", [math.nan, math.inf, -math.inf, -100.0, 1e9])
def test_an_absurd_meter_leaves_no_trace(absurd_kw: float) -> None:
    central = AtWork(central_plan(), "central")
    for cycle, metered_kw in enumerate((50.0, absurd_kw)):
        cycle_with_meter(central, cycle, metered_kw)
    assert cycle_with_meter(central, 2, 50.0) == pytest.approx(50.0)
    assert central.loop.dropped == {("meter", "absurd"): 1}


def test_a_reading_counts_once_however_long_it_holds() -> None:
    central = AtWork(central_plan(), "central")
    cycle_with_meter(central, 0, 50.0)
    once_kw = cycle_with_meter(central, 1, 40.0)
    assert once_kw == pytest.approx(50.0 + 0.5 * 10.0)
    assert [cycle_with_meter(central, cycle, None) for cycle in (2, 3, 4, 5)] == [once_kw] * 4
    assert cycle_with_meter(central, 6, 40.0) == pytest.approx(50.0 + 10.0)


def test_a_late_reading_counts_for_less() -> None:
    set_kw = []
    for metered_in in (3, 2, 1):
        central = AtWork(central_plan(), "central")
        for cycle in range(3):
            cycle_with_meter(central, cycle, None)
        central.hear(meter(metered_in, 40.0))
        set_kw.append(cycle_with_meter(central, 3, None))
    assert set_kw[0] == pytest.approx(50.0 + 0.5 * 10.0)
    assert set_kw[0] > set_kw[1] > set_kw[2] > 50.0


def test_a_controller_that_acts_rarely_corrects_by_the_mean_of_its_readings() -> None:
    central = AtWork(central_plan(period_cycles=(5,)), "central")
    set_kw = [cycle_with_meter(central, cycle, 45.0) for cycle in range(11)]
    # In cycle 0 there was no dispatch before that could have been missed.
    assert set_kw[0] == pytest.approx(50.0)
    assert set_kw[1:5] == [0.0] * 4
    assert set_kw[5] == pytest.approx(50.0 + HIGHEST_GAIN * 5.0)
    assert set_kw[10] == pytest.approx(50.0 + HIGHEST_GAIN * 5.0 * 2)


def central_plan(**changes: object) -> RunPlan:
    """Two inverters below a central controller that corrects, by the clock."""
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=300, correction=True, cycle_wall_ns=REAL_TIME)
    return msgspec.structs.replace(plan, **changes)


def cycle_with_meter(central: AtWork, cycle: int, metered_kw: float | None) -> float:
    """Let a cycle go by in which 50 kW are dispatched; return what is set in all."""
    reports = report("a", cycle, 80.0, 55.0) + report("b", cycle, 80.0, 55.0)
    sent = central.hear(dispatch(cycle, 50.0, 200.0), *reports)
    if metered_kw is None:
        sent |= central.at_deadline("solve")
    else:
        sent |= central.hear(meter(cycle, metered_kw))
    return sum(message.power_kw for message in sent.values() if isinstance(message, Setpoint))
