"""Numbers that cannot be right are named; all that the plant and its controllers say is right."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.messages import (
    Command,
    Dispatch,
    Help,
    Impp,
    Message,
    Production,
    Residual,
    Run,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    HELP,
    IMPP,
    PRODUCTION,
    RESIDUAL,
    RUN,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import ROOT
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.record.plausibility import absurdities

PREPARED = prepare(load_scenario("oahu"), RunOptions(duration="20"), "plausible")
PLAN: RunPlan = PREPARED.plan
LEAF = PLAN.tree.leaves[0]
RATING_KW = PLAN.tree.rating_kw(LEAF)
HEARD_NS = 77_000_000_000
HEAD = (3, PLAN.sim_time_ns(3), "somebody", ())


def absurdity(plan: RunPlan, port: Port[Message], message: Message, heard_ns: int) -> str:
    return "; ".join(absurdities(plan, port, message, heard_ns).values())


def test_nothing_that_a_run_says_is_absurd() -> None:
    said: list[tuple[Port[Message], str]] = []

    def hear(port: Port[Message], message: Message) -> None:
        said.append((port, absurdity(PLAN, port, message, HEARD_NS)))

    for _ in MemoryRun(PLAN, PREPARED.profile, hear).cycles():
        pass
    assert len(said) > 2000
    assert [(str(port), what) for port, what in said if what] == []


@pytest.mark.parametrize("power_kw", [nan, inf, -inf, -1.0, 1e9])
def test_powers_outside_of_what_the_inverter_can_are_named(power_kw: float) -> None:
    absurd: list[tuple[Port[Message], Message]] = [
        (IMPP.of(LEAF), Impp(*HEAD, power_kw=power_kw, stale_cycles=0)),
        (RESIDUAL.of(LEAF), Residual(*HEAD, power_kw=power_kw * 1e3)),
        (HELP.of(LEAF), Help(*HEAD, missing_kw=power_kw)),
        (SETPOINT.of(LEAF), Setpoint(*HEAD, power_kw=power_kw, share_kw=0.0, help_given=())),
        (COMMAND.of(LEAF), Command(*HEAD, alpha=1.0, power_kw=power_kw)),
        (TELEMETRY.of(LEAF), Telemetry(*HEAD, power_kw=power_kw, alpha=1.0, limit_kw=0.0)),
    ]
    for port, message in absurd:
        assert f"is {power_kw * (1e3 if port.signal is RESIDUAL else 1):.10g}, expected" in (
            absurdity(PLAN, port, message, HEARD_NS)
        )


@pytest.mark.parametrize("power_kw", [-2000.0, 0.0, 1e9])
def test_a_dispatch_beyond_the_ratings_is_acted_on_and_so_not_absurd(power_kw: float) -> None:
    dispatch = Dispatch(
        *HEAD, power_kw=power_kw, plant_rating_kw=1.0, commitment_kw=0.0, regulation_kw=power_kw
    )
    assert absurdity(PLAN, DISPATCH.of(ROOT), dispatch, HEARD_NS) == ""


@pytest.mark.parametrize("field", ["power_kw", "commitment_kw", "regulation_kw"])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_dispatch_without_a_number_is_named(field: str, value: float) -> None:
    dispatch = Dispatch(
        *HEAD, power_kw=1.0, plant_rating_kw=1.0, commitment_kw=1.0, regulation_kw=0.0
    )
    found = absurdity(PLAN, DISPATCH.of(ROOT), replace(dispatch, **{field: value}), HEARD_NS)
    assert found == f"{field} is {value:g}, expected finite numbers"


@pytest.mark.parametrize("alpha", [nan, 0.0, -0.1, 1.01])
def test_an_alpha_outside_0_to_1_is_named(alpha: float) -> None:
    command = Command(*HEAD, alpha=alpha, power_kw=0.0)
    assert absurdity(PLAN, COMMAND.of(LEAF), command, HEARD_NS).startswith("alpha is")


def test_a_simulated_time_that_is_not_the_cycles_is_named() -> None:
    good = Impp(*HEAD, power_kw=RATING_KW, stale_cycles=0)
    assert absurdity(PLAN, IMPP.of(LEAF), good, HEARD_NS) == ""
    assert "sim_time_ns is 7" in absurdity(
        PLAN, IMPP.of(LEAF), replace(good, sim_time_ns=7), HEARD_NS
    )


def test_each_field_that_cannot_be_right_is_named() -> None:
    bad = Command(3, 7, "somebody", (), alpha=nan, power_kw=-1.0)
    found = absurdities(PLAN, COMMAND.of(LEAF), bad, HEARD_NS)
    assert list(found) == ["sim_time_ns", "alpha", "power_kw"]
    assert found["alpha"].startswith("alpha is nan, expected")


@pytest.mark.parametrize(("entries", "total_kw"), [(16, 1.0), (17, nan), (0, 1.0)])
def test_a_production_of_other_inverters_or_without_numbers_is_named(
    entries: int, total_kw: float
) -> None:
    production = Production(
        *HEAD,
        desired_kw=1.0,
        possible_kw=total_kw,
        delivered_kw=1.0,
        inverter_mpp_kw=(1.0,) * entries,
        inverter_power_kw=(1.0,) * entries,
    )
    assert absurdity(PLAN, PRODUCTION.of(ROOT), production, HEARD_NS)


def start(**changes: object) -> Run:
    plan = replace(PLAN, cycle_wall_ns=1_000_000_000)
    return replace(plan.run_message("start", 0, HEARD_NS + 200_000_000), **changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, ""),
        ({"start_time_ns": HEARD_NS - 9_000_000_000}, ""),
        ({"start_time_ns": 0}, "start_time_ns is 0 and came at 77000000000 of this host's"),
        ({"start_time_ns": HEARD_NS + 11_000_000_000}, "start_time_ns is 88000000000"),
        ({"cycle_wall_ns": 0}, "cycle_wall_ns is 0, expected 1000000000"),
        ({"cycle_wall_ns": 2_000_000_000}, "cycle_wall_ns is 2000000000, expected"),
        ({"cycle": 3, "sim_time_ns": HEAD[1]}, "the run begins with cycle 3, expected 0"),
    ],
)
def test_a_run_that_begins_at_an_impossible_time_is_named(
    changes: dict[str, object], told: str
) -> None:
    plan = replace(PLAN, cycle_wall_ns=1_000_000_000)
    found = absurdity(plan, RUN.of(ROOT), start(**changes), HEARD_NS)
    assert found.startswith(told)
    assert bool(found) == bool(told)


def test_in_lockstep_no_clock_is_looked_at() -> None:
    message = PLAN.run_message("start", 0, 0)
    assert absurdity(PLAN, RUN.of(ROOT), message, HEARD_NS) == ""


def test_no_curtailment_level_is_zero() -> None:
    zero = Command(*HEAD, alpha=0.0, power_kw=1.0)
    told = absurdity(PLAN, COMMAND.of(LEAF), zero, HEARD_NS)
    assert told == "alpha is 0, expected above 0 to 1"
