"""Campaigns of random faults: they hold, they repeat, and they find a mistake that was planted."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from typer.testing import CliRunner

from agents import parent
from agents.agent import Turn
from agents.control import allocation
from agents.direct import DirectController, DirectState
from agents.loop import AgentLoop
from agents.parent import Parent, Report, Supervisor
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Dispatch
from launch_scripts.app import app
from launch_scripts.scenarios.fault_rules import parse_fault
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from sim_plant.plant import Plant
from sim_plant.profile import Profile
from studies.campaign.curves import Protection, failures, run_under
from studies.campaign.study import campaign, judge, random_rules, run_seed, trace_of

Patch = pytest.MonkeyPatch


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions(duration="150s"), "campaign")


def broken_by(oahu: Preparation, fault: str, restart_takes_s: float) -> set[str]:
    """Return the invariants that a run under a fault breaks."""
    found = campaign(oahu)
    rules = (parse_fault(fault),)
    trace = trace_of(found.plan, found.profile, rules, restart_takes_s)
    return {violation.invariant for violation in judge(found, rules, trace)}


def test_seeds_hold_and_repeat(oahu: Preparation) -> None:
    found = campaign(oahu)
    outcomes = [run_seed(found, seed) for seed in range(1, 13)]
    assert [outcome.violations for outcome in outcomes] == [()] * 12
    assert any(outcome.under_kwh > 0.0 for outcome in outcomes)
    assert run_seed(found, 7) == outcomes[6]


def test_a_seed_draws_the_same_faults_of_all_kinds(oahu: Preparation) -> None:
    plan = campaign(oahu).plan
    texts = [str(rule) for seed in range(50) for rule in random_rules(plan, seed)]
    assert texts == [str(rule) for seed in range(50) for rule in random_rules(plan, seed)]
    assert all(any(kind in text for text in texts) for kind in ("kill", "freeze", "partition"))
    assert [str(parse_fault(text)) for text in texts] == texts


def silence_counts_as_zero(patch: Patch) -> None:
    """A parent gives the share of a silent child to others."""
    right = Parent._report

    def wrong(self: Parent, turn: Turn, child: object, dispatch: Dispatch | None) -> Report:
        report = right(self, turn, child, dispatch)  # type: ignore[arg-type]
        return report._replace(impp_kw=0.0, is_silent=False) if report.is_silent else report

    patch.setattr(Parent, "_report", wrong)


def inverters_never_revert(patch: Patch) -> None:
    right = Plant.__init__

    def wrong(self: Plant, plan: RunPlan, profile: Profile) -> None:
        right(self, plan, profile)
        self._revert_cycles = np.full(len(plan.tree.leaves), inf)

    patch.setattr(Plant, "__init__", wrong)


def nobody_joins_later(patch: Patch) -> None:
    patch.setattr(AgentLoop, "_join", lambda self, dispatch, now_ns: None)


def more_is_shared_out_than_there_is(patch: Patch) -> None:
    right = allocation.allocate

    def wrong(target_kw: float, *rest: Any) -> tuple[Any, ...]:
        return right(1.2 * target_kw + 200.0, *rest)

    patch.setattr(parent, "allocate", wrong)


def setpoints_come_twice(patch: Patch) -> None:
    right = Supervisor.step

    def wrong(self: Supervisor, state: None, turn: Turn) -> tuple[None, list[Delivery]]:
        state, outputs = right(self, state, turn)
        return state, outputs + outputs if turn.stage == "solve" else outputs

    patch.setattr(Supervisor, "step", wrong)


def commands_stop_the_inverter(patch: Patch) -> None:
    right = DirectController._actuate

    def wrong(self: DirectController, state: DirectState, turn: Turn) -> list[Delivery]:
        outputs = right(self, state, turn)
        for _, message in outputs:
            if isinstance(message, Command) and turn.cycle > 60:
                message.alpha, message.power_kw = 0.01, 0.0
        return outputs

    patch.setattr(DirectController, "_actuate", wrong)


@pytest.mark.parametrize(
    ("plant_mistake", "fault", "restart_takes_s", "found"),
    [
        (silence_counts_as_zero, "kill=c2,at=30s", inf, "over-delivery"),
        (inverters_never_revert, "kill=c2/*,at=30s", inf, "revert"),
        (nobody_joins_later, "kill=c2/*,at=30s", 0.5, "recovery"),
        (more_is_shared_out_than_there_is, "kill=c2,at=30s", 0.5, "shares"),
        (setpoints_come_twice, "kill=c2,at=30s", 0.5, "one authority"),
        (commands_stop_the_inverter, "kill=c2,at=30s", 0.5, "under-delivery"),
    ],
)
def test_a_planted_mistake_is_found(
    oahu: Preparation,
    monkeypatch: Patch,
    plant_mistake: Callable[[Patch], None],
    fault: str,
    restart_takes_s: float,
    found: str,
) -> None:
    assert found not in broken_by(oahu, fault, restart_takes_s)
    plant_mistake(monkeypatch)
    assert found in broken_by(oahu, fault, restart_takes_s)


def test_a_failing_seed_is_shrunk_and_printed_as_a_command(monkeypatch: Patch) -> None:
    nobody_joins_later(monkeypatch)
    result = CliRunner().invoke(
        app, ["campaign", "oahu", "--seeds", "1..2", "--set", "commitment.share=0.75"]
    )
    assert result.exit_code == 1
    commands = [line for line in result.output.splitlines() if "heliarch simulate oahu" in line]
    assert commands
    assert any(line.count("--fault") == 1 for line in commands)


def test_a_policy_that_ends_the_run_is_named() -> None:
    words = ["campaign", "oahu", "--seeds", "1..2", "--set", "restart.when=never"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert ": end, cycle" in result.output
    assert "was killed in the middle of the run" in result.output


# What failures cost -------------------------------------------------------------------------------


def test_failures_are_the_same_for_every_protection_and_cost_more_without(
    oahu: Preparation,
) -> None:
    found = campaign(oahu)
    rules = failures(found.plan, 100.0, 1)
    assert rules == failures(found.plan, 100.0, 1) != failures(found.plan, 100.0, 2)
    assert len(failures(found.plan, 1000.0, 1)) > len(rules) > 20
    points = {name: run_under(found, (name, 100.0, inf, 1)) for name in get_args(Protection)}
    assert points["neither"].over_percent > 2.0 * points["default"].over_percent > 0.0
    assert run_under(found, ("default", 100.0, 0.5, 1)).over_percent < 0.1


def test_a_page_draws_the_worst_seeds(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    words = ["campaign", "oahu", "--seeds", "1..3", "--report", str(page)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    text = page.read_text(encoding="utf-8")
    assert "0 of 3 seeds broke an invariant" in text
    assert len(re.findall(r'id="seed-\d-plot-data"', text)) == 3
    assert re.search(r"Faults: .*(kill|freeze|partition|loss)=", text)
