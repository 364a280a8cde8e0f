"""The study of delay, loss and slow central control, on a few minutes of clouds."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from agents.settings import Scheme
from agents.team import controllers
from bus_schemas.faults import FaultRule
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.delays.results import survived, trouble_table
from studies.delays.study import (
    WARM_UP_S,
    Condition,
    Outcome,
    Trouble,
    conditions,
    plan_under,
    run_in_memory,
    run_under,
)
from studies.metrics import run_metrics
from studies.metrics.figures_of_merit import figures_json

CYCLES = 210


@pytest.fixture(scope="module")
def prepared() -> Preparation:
    options = RunOptions(start="12:00", duration=f"{CYCLES}s")
    return prepare(load_scenario("oahu-day"), options, "study")


def outcome(prepared: Preparation, condition: Condition) -> Outcome:
    return run_under(prepared.plan, prepared.profile, condition)


PERFECT = Condition("delay", 0.0, "predictive")


@pytest.fixture(scope="module")
def perfect(prepared: Preparation) -> Outcome:
    """What the study's run comes to over a perfect network."""
    return outcome(prepared, PERFECT)


@pytest.mark.parametrize(
    ("cycle_s", "cycles", "periods_s"),
    [
        (5, 744, {5.0, 10.0, 30.0, 60.0}),  # Whole numbers of cycles,
        (1, 150, {1.0, 2.0, 5.0, 10.0}),  # of which what counts, 30 s, holds two.
    ],
)
def test_central_periods_that_do_not_fit_are_left_out(
    prepared: Preparation, cycle_s: int, cycles: int, periods_s: set[float]
) -> None:
    plan = msgspec.structs.replace(prepared.plan, cycle_ns=cycle_s * 10**9, cycles=cycles)
    chosen = conditions(plan)
    assert {one.value for one in chosen if one.trouble == "period"} == periods_s


def test_a_condition_stands_in_the_plan(prepared: Preparation) -> None:
    delayed = plan_under(prepared.plan, Condition("delay", 0.2, "paper"))
    assert delayed.faults == (FaultRule(delay_ms=200.0),)
    assert (delayed.scheme, delayed.correction, delayed.cycle_wall_ns) == ("paper", False, 10**9)
    lossy = plan_under(prepared.plan, Condition("loss", 0.5, "paper"))
    assert lossy.faults == (FaultRule(loss=0.005),)
    slow = plan_under(prepared.plan, Condition("period", 30.0, "paper"))
    assert (slow.faults, slow.period_cycles) == ((), (30, 1))
    assert plan_under(prepared.plan, PERFECT).correction
    stated = msgspec.structs.replace(prepared.plan, correction=False)
    assert not plan_under(stated, PERFECT).correction


def test_a_perfect_network_gives_what_lockstep_gives_without_the_beginning(
    prepared: Preparation, perfect: Outcome
) -> None:
    _, series = run_in_memory(prepared.plan, prepared.profile)
    counted = series.between(round(WARM_UP_S), series.cycles)
    assert counted.cycles == CYCLES - 120
    assert perfect.figures == figures_json(run_metrics(counted))
    assert (perfect.absent_inputs, perfect.old_inputs) == (0, 0)


@pytest.mark.parametrize(
    ("trouble", "values", "scheme"),
    [("delay", (0.0, 0.5, 2.0, 5.0), "predictive"), ("period", (1.0, 60.0), "paper")],
)
def test_a_trouble_costs_the_more_the_worse_it_is(
    prepared: Preparation, trouble: Trouble, values: tuple[float, ...], scheme: Scheme
) -> None:
    shortfalls = [
        outcome(prepared, Condition(trouble, value, scheme)).figures["control-caused"]
        for value in values
    ]
    assert np.all(np.diff(np.array(shortfalls, dtype=float)) > 0.0)


def test_losses_cost_the_more_the_more_there_are(prepared: Preparation) -> None:
    found = [outcome(prepared, Condition("loss", value, "paper")) for value in (0.0, 5.0, 20.0)]
    plan = prepared.plan
    stages = [
        stage for one in controllers(plan) for at in range(plan.cycles) for stage in one.stages(at)
    ]
    awaited = plan.cycles * len(plan.tree.leaves) + sum(len(stage.awaits) for stage in stages)
    absent_percent = [100.0 * one.absent_inputs / awaited for one in found]
    assert absent_percent[0] == 0.0
    assert absent_percent[1] == pytest.approx(5.0, abs=0.5)
    mileages = np.array([one.figures["mileage"] for one in found], dtype=float)
    assert np.all(np.diff(mileages) > 0.0)


def test_figures_of_regulation_are_shown_only_where_there_is_some(perfect: Outcome) -> None:
    without = msgspec.structs.replace(perfect, figures={**perfect.figures, "regd": None})
    shown, left = (set(trouble_table("delay", [one]).names()) for one in (perfect, without))
    assert shown - left == {"regd"}


def made_up(
    trouble: Trouble, value: float, shortfall: float | None, over_delivered: float = 0.2
) -> Outcome:
    figures = {"control-caused": shortfall, "over-delivered": over_delivered}
    return Outcome(
        trouble=trouble,
        value=value,
        scheme="paper",
        figures=figures,
        absent_inputs=0,
        old_inputs=0,
    )


def test_a_trouble_is_survived_up_to_the_first_value_that_costs_too_much() -> None:
    paper, _ = survived(
        [
            made_up("delay", 0.0, 0.1),
            made_up("delay", 0.2, 0.99),
            made_up("delay", 0.5, 1.0),
            made_up("delay", 1.0, 0.5),
            # Commands that never arrive: each inverter gives all it can, and nothing is short.
            made_up("loss", 0.0, 0.0, over_delivered=67.9),
            made_up("period", 1.0, None),
        ]
    )
    assert paper.endswith("delay of each hop up to 0.2 s, no lost messages, no central period")
