"""The central controller corrects its target by what the plant's meter read: the integral part."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plants_by_hand import REAL_TIME, AtWork, Heard, at, dispatch, hear_profile, meter, plan_of, report

from bus_schemas.messages import Setpoint
from bus_schemas.signals import METER, PRODUCTION, SETPOINT
from bus_schemas.tree import ROOT
from launch_scripts.preparation import RunOptions, prepare
from launch_scripts.scenario import load_scenario
from sim_plant.profile import Profile

CYCLES = 60


def dimmed(**changes: Any) -> Heard:
    """Two inverters whose meters read 2 % too much, so that they give 2 % too little.

    Each has 100 kW, of which 60 kW are desired.
    """
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=CYCLES, **changes)
    error = np.full((CYCLES, 2), 0.02)
    profile = Profile(np.full((CYCLES, 2), 80.0), np.full(CYCLES, 120.0), meter_error=error)
    return hear_profile(plan, profile)[1]


def target_kw(heard: Heard, cycle: int) -> float:
    """What is set in all."""
    return sum(heard.get(cycle, SETPOINT.of(node)).power_kw for node in ("a", "b"))


def test_a_lasting_error_is_corrected_away() -> None:
    heard = dimmed(correction=True)
    first, last = (heard.get(cycle, PRODUCTION.of(ROOT)).delivered_kw for cycle in (2, CYCLES - 1))
    assert first < 120.0 - 1.0
    assert last == pytest.approx(120.0, abs=0.05)
    assert target_kw(heard, CYCLES - 1) > 121.0


def test_without_correction_it_stays() -> None:
    heard = dimmed(correction=False)
    assert heard.get(CYCLES - 1, PRODUCTION.of(ROOT)).delivered_kw == pytest.approx(120.0 / 1.02)
    assert target_kw(heard, CYCLES - 1) == pytest.approx(120.0)


def test_where_all_there_is_falls_short_nothing_is_added() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=CYCLES, correction=True)
    # Too dark for a while; then there is more than is desired again.
    mpp_kw = np.array([[40.0 if cycle < CYCLES - 2 else 90.0] * 2 for cycle in range(CYCLES)])
    _, heard = hear_profile(plan, Profile(mpp_kw, np.full(CYCLES, 120.0)))
    assert target_kw(heard, CYCLES - 1) <= 120.0 + 1e-9


def test_the_correction_is_a_tenth_of_the_rating_at_most_and_never_negative() -> None:
    central = AtWork(central_plan(), "central")
    for cycle in range(100):
        over = cycle_with_meter(central, cycle, power_kw=100.0, desired_kw=50.0)
    assert over == pytest.approx(50.0), "too much is not taken back"
    for cycle in range(100, 200):
        short = cycle_with_meter(central, cycle, power_kw=0.0, desired_kw=50.0)
    assert short == pytest.approx(50.0 + 20.0)


@pytest.mark.parametrize("field", ["power_kw", "desired_kw"])
@pytest.mark.parametrize("absurd_kw", [math.nan, math.inf, -math.inf, -1.0, 1e9])
def test_an_absurd_meter_leaves_no_trace(field: str, absurd_kw: float) -> None:
    central = AtWork(central_plan(), "central")
    cycle_with_meter(central, 0, power_kw=50.0, desired_kw=50.0)
    cycle_with_meter(central, 1, **({"power_kw": 50.0, "desired_kw": 50.0} | {field: absurd_kw}))
    found = cycle_with_meter(central, 2, power_kw=50.0, desired_kw=50.0)
    assert found == pytest.approx(50.0)
    assert central.loop.dropped == {("meter", "absurd"): 1}


def test_a_meter_that_is_late_is_counted_once() -> None:
    central = AtWork(central_plan(), "central")
    cycle_with_meter(central, 0, power_kw=50.0, desired_kw=50.0)
    once = cycle_with_meter(central, 1, power_kw=40.0, desired_kw=50.0)
    found = []
    for cycle in (2, 3):
        central.hear(dispatch(cycle, 50.0, 200.0), *reports(cycle))
        sent = central.at_deadline("solve")
        found.append(sum(m.power_kw for m in sent.values() if isinstance(m, Setpoint)))
    assert found == [pytest.approx(once)] * 2


def central_plan() -> Any:
    return plan_of({"a": 100.0, "b": 100.0}, cycles=300, correction=True, cycle_wall_ns=REAL_TIME)


def reports(cycle: int) -> list[Any]:
    return report("a", cycle, 80.0, 55.0) + report("b", cycle, 80.0, 55.0)


def cycle_with_meter(central: AtWork, cycle: int, *, power_kw: float, desired_kw: float) -> float:
    """Let a cycle go by in which 50 kW are dispatched; return what is set in all."""
    sent = central.hear(
        dispatch(cycle, 50.0, 200.0), meter(cycle, power_kw, desired_kw), *reports(cycle)
    )
    return sum(at(sent, SETPOINT.of(node)).power_kw for node in ("a", "b"))


def test_the_meter_reads_what_was_delivered_beside_what_was_desired_then() -> None:
    plan = plan_of({"a": 100.0, "b": 100.0}, cycles=5)
    mpp_kw = np.array([[80.0, 60.0], [50.0, 60.0], [90.0, 90.0], [90.0, 90.0], [90.0, 90.0]])
    wanted_kw = np.array([100.0, 120.0, -5.0, 500.0, 100.0])
    _, heard = hear_profile(plan, Profile(mpp_kw, wanted_kw))
    for cycle in range(1, 5):
        found, made = heard.get(cycle, METER.of(ROOT)), heard.get(cycle - 1, PRODUCTION.of(ROOT))
        assert found.power_kw == made.delivered_kw
        assert found.desired_kw == min(max(made.desired_kw, 0.0), 200.0)


@pytest.mark.parametrize(
    ("scheme", "said", "corrects"),
    [
        ("predictive", None, True),
        ("paper", None, False),
        ("predictive", "false", False),
        ("paper", "true", True),
    ],
)
def test_it_goes_with_the_scheme_unless_the_scenario_says_otherwise(
    tmp_path: Any, scheme: Any, said: str | None, corrects: bool
) -> None:
    oahu = load_scenario("oahu")
    text = oahu.text.replace('inverters = "oahu.csv"', f'inverters = "{oahu.path.parent}/oahu.csv"')
    if said is not None:
        text = text.replace("[control]", f"[control]\ncorrection = {said}")
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    plan = prepare(load_scenario(str(path)), RunOptions(duration="1", scheme=scheme), "any").plan
    assert plan.correction is corrects
