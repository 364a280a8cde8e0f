"""Numbers that cannot be right are named; everything that the plant and its controllers say is."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace
from recorded_runs import published

from agents.plan import RunPlan
from bus_schemas import messages, signals
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import ROOT
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.record.plausibility import absurdity

PREPARED = prepare(load_scenario("oahu"), RunOptions(duration="20"), "plausible")
PLAN: RunPlan = PREPARED.plan
REAL_TIME = replace(PLAN, cycle_wall_ns=1_000_000_000)
LEAF = PLAN.tree.leaves[0]
HEARD_NS = 77_000_000_000
HEAD = (3, PLAN.sim_time_ns(3), "somebody", ())
GOOD_DISPATCH = messages.Dispatch(
    *HEAD, power_kw=1.0, plant_rating_kw=1.0, commitment_kw=1.0, regulation_kw=0.0
)


def test_nothing_that_a_run_says_is_absurd() -> None:
    said = [
        absurdity(PLAN, port, message, HEARD_NS)
        for port, message in published(PLAN, PREPARED.profile)
    ]
    assert len(said) > 2000
    assert not any(said)


@pytest.mark.parametrize("power_kw", [nan, inf, -inf, -1.0, 1e9])
def test_powers_beyond_what_the_inverter_can_produce_are_named(power_kw: float) -> None:
    absurd: list[tuple[Port[Message], Message]] = [
        (signals.IMPP.of(LEAF), messages.Impp(*HEAD, power_kw=power_kw, stale_cycles=0)),
        (signals.RESIDUAL.of(LEAF), messages.Residual(*HEAD, power_kw=power_kw * 1e3)),
        (signals.HELP.of(LEAF), messages.Help(*HEAD, missing_kw=power_kw)),
        (
            signals.SETPOINT.of(LEAF),
            messages.Setpoint(*HEAD, power_kw=power_kw, share_kw=0.0, help_given=()),
        ),
        (signals.COMMAND.of(LEAF), messages.Command(*HEAD, alpha=1.0, power_kw=power_kw)),
        (
            signals.TELEMETRY.of(LEAF),
            messages.Telemetry(*HEAD, power_kw=power_kw, alpha=1.0, limit_kw=0.0),
        ),
    ]
    for port, message in absurd:
        assert "_kw: expected " in absurdity(PLAN, port, message, HEARD_NS)


def test_a_dispatch_beyond_the_ratings_is_acted_on_and_so_not_absurd() -> None:
    for power_kw in (-2000.0, 1e9):
        dispatch = replace(GOOD_DISPATCH, power_kw=power_kw)
        assert absurdity(PLAN, signals.DISPATCH.of(ROOT), dispatch, HEARD_NS) == ""


@pytest.mark.parametrize("field", ["power_kw", "commitment_kw", "regulation_kw"])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_dispatch_that_is_not_finite_is_named(field: str, value: float) -> None:
    dispatch = replace(GOOD_DISPATCH, **{field: value})
    found = absurdity(PLAN, signals.DISPATCH.of(ROOT), dispatch, HEARD_NS)
    assert found.startswith(f"{field}: expected a finite number, got")


@pytest.mark.parametrize("alpha", [nan, 0.0, -0.1, 1.01])
def test_an_alpha_outside_0_to_1_is_named(alpha: float) -> None:
    command = messages.Command(*HEAD, alpha=alpha, power_kw=0.0)
    assert absurdity(PLAN, signals.COMMAND.of(LEAF), command, HEARD_NS).startswith(
        "alpha: expected"
    )


@pytest.mark.parametrize(("entries", "total_kw"), [(16, 1.0), (17, nan), (0, 1.0)])
def test_a_production_of_other_inverters_is_named(entries: int, total_kw: float) -> None:
    production = messages.Production(
        *HEAD,
        desired_kw=1.0,
        possible_kw=total_kw,
        delivered_kw=1.0,
        inverter_mpp_kw=(1.0,) * entries,
        inverter_power_kw=(1.0,) * entries,
    )
    assert absurdity(PLAN, signals.PRODUCTION.of(ROOT), production, HEARD_NS)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({}, ""),
        ({"start_time_ns": HEARD_NS - 9_000_000_000}, ""),
        ({"sim_time_ns": 7}, "sim_time_ns"),
        ({"start_time_ns": 0}, "start_time_ns"),
        ({"start_time_ns": HEARD_NS + 11_000_000_000}, "start_time_ns"),
        ({"cycle_wall_ns": 0}, "cycle_wall_ns"),
        ({"cycle": 3, "sim_time_ns": HEAD[1]}, "cycle"),
    ],
)
def test_a_run_with_an_impossible_start_is_named(changes: dict[str, object], field: str) -> None:
    start = replace(REAL_TIME.run_message("start", 0, HEARD_NS), **changes)
    assert absurdity(REAL_TIME, signals.RUN.of(ROOT), start, HEARD_NS).partition(":")[0] == field


def test_in_lockstep_the_start_time_does_not_matter() -> None:
    assert absurdity(PLAN, signals.RUN.of(ROOT), PLAN.run_message("start", 0, 0), HEARD_NS) == ""
