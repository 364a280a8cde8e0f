"""Campaigns of random faults: they hold, they repeat, and they find a mistake that was planted."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any

import pytest
from command_line import heliarch

from agents import parent
from agents.agent import Turn
from agents.control import allocation
from agents.faults import Freeze, Kill
from agents.loop import Loop
from agents.parent import Parent, Report
from agents.plan import RunPlan, changed
from agents.team import Controller, controller
from bus_schemas.bus import Delivery
from bus_schemas.faults import Disturbance, Partition
from bus_schemas.messages import Command, Dispatch, Message, Setpoint
from bus_schemas.signals import Port
from scenarios.fault_rules import fault_text, parse_fault
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario
from sim_plant.plant import Plant
from sim_plant.profile import Profile
from studies.campaign.study import Campaign, campaign, faults_of, judge, run_seed, trace_of

Patch = pytest.MonkeyPatch
Make = Callable[[RunPlan, str], Controller]
Change = Callable[[list[Delivery]], list[Delivery]]


@pytest.fixture(scope="module")
def oahu() -> Campaign:
    return campaign(prepare(load_scenario("oahu"), RunOptions(duration="150s"), "campaign"))


def broken_by(
    oahu: Campaign, fault: str, restart_takes_s: float, make: Make = controller
) -> set[str]:
    """Return the invariants that a run under a fault breaks."""
    faults = (parse_fault(fault),)
    trace = trace_of(oahu.plan, oahu.profile, faults, restart_takes_s, make)
    return {violation.invariant for violation in judge(oahu, faults, trace)}


def test_seeds_hold_and_repeat(oahu: Campaign) -> None:
    results = [run_seed(oahu, seed) for seed in range(1, 9)]
    assert [result.violations for result in results] == [()] * 8
    assert any(result.under_kwh > 0.0 for result in results)
    assert run_seed(oahu, 7) == results[6]


def test_a_seed_draws_the_same_faults_of_all_kinds(oahu: Campaign) -> None:
    plan = oahu.plan
    drawn = [fault for seed in range(50) for fault in faults_of(plan, seed)]
    assert drawn == [fault for seed in range(50) for fault in faults_of(plan, seed)]
    assert {type(fault) for fault in drawn} == {Kill, Freeze, Partition, Disturbance}
    assert [parse_fault(fault_text(fault)) for fault in drawn] == drawn


# Mistakes in the code -----------------------------------------------------------------------------


def replace_result(patch: Patch, owner: object, name: str, wrong: Callable[[Any], Any]) -> None:
    """Let a function, or a method of a class, return something else than it should."""
    right = getattr(owner, name)
    patch.setattr(owner, name, lambda *words: wrong(right(*words)))


def silence_counts_as_zero(patch: Patch) -> None:
    """A parent gives the share of a silent child to others."""

    def wrong(reports: list[Report]) -> list[Report]:
        return [
            report._replace(impp_kw=0.0, is_expired=False) if report.is_expired else report
            for report in reports
        ]

    replace_result(patch, Parent, "reports", wrong)


def inverters_never_revert(patch: Patch) -> None:
    right = Plant.__init__

    def wrong(self: Plant, plan: RunPlan, profile: Profile) -> None:
        right(self, changed(plan, site={"revert": None}), profile)

    patch.setattr(Plant, "__init__", wrong)


def nobody_joins_later(patch: Patch) -> None:
    right = Loop.hear

    def wrong(self: Loop[Any], port: Port[Message], message: Message, time_ns: int) -> None:
        is_under_way = isinstance(message, Dispatch) and message.cycle > 0
        if self.cycle >= 0 or not is_under_way:
            right(self, port, message, time_ns)

    patch.setattr(Loop, "hear", wrong)


def more_is_shared_out_than_there_is(patch: Patch) -> None:
    right = allocation.allocate
    patch.setattr(parent, "allocate", lambda kw, *rest: right(1.2 * kw + 200.0, *rest))


class Mistaken:
    """A controller that sends something else than it should."""

    def __init__(
        self, right: Controller, change: Callable[[list[Delivery]], list[Delivery]]
    ) -> None:
        self.name, self.may_skip = right.name, right.may_skip
        self.initial_state, self.stages = right.initial_state, right.stages
        self._right, self._change = right, change

    def step(self, state: object, turn: Turn) -> tuple[object, list[Delivery]]:
        state, outputs = self._right.step(state, turn)
        return state, self._change(outputs)


def setpoints_come_twice(plan: RunPlan, name: str) -> Controller:
    def change(outputs: list[Delivery]) -> list[Delivery]:
        return outputs + [pair for pair in outputs if isinstance(pair[1], Setpoint)]

    return Mistaken(controller(plan, name), change)


def commands_stop_the_inverter(plan: RunPlan, name: str) -> Controller:
    def change(outputs: list[Delivery]) -> list[Delivery]:
        for _, message in outputs:
            if isinstance(message, Command) and message.cycle > 60:
                message.alpha, message.power_kw = 0.01, 0.0
        return outputs

    return Mistaken(controller(plan, name), change)


@pytest.mark.parametrize(
    ("mistaken", "invariant"),
    [(setpoints_come_twice, "one authority"), (commands_stop_the_inverter, "under-delivery")],
)
def test_a_mistaken_controller_is_found(oahu: Campaign, mistaken: Make, invariant: str) -> None:
    assert invariant not in broken_by(oahu, "kill=c2,at=30s", 0.5)
    assert invariant in broken_by(oahu, "kill=c2,at=30s", 0.5, mistaken)


@pytest.mark.parametrize(
    ("plant_mistake", "fault", "restart_takes_s", "invariant"),
    [
        (silence_counts_as_zero, "kill=c2,at=30s", inf, "over-delivery"),
        (inverters_never_revert, "kill=c2/*,at=30s", inf, "revert"),
        (nobody_joins_later, "kill=c2/*,at=30s", 0.5, "recovery"),
        (more_is_shared_out_than_there_is, "kill=c2,at=30s", 0.5, "shares"),
    ],
)
def test_a_planted_mistake_is_found(
    oahu: Campaign,
    monkeypatch: Patch,
    plant_mistake: Callable[[Patch], None],
    fault: str,
    restart_takes_s: float,
    invariant: str,
) -> None:
    assert invariant not in broken_by(oahu, fault, restart_takes_s)
    plant_mistake(monkeypatch)
    assert invariant in broken_by(oahu, fault, restart_takes_s)


def test_a_failing_seed_is_shrunk_and_printed_as_a_command(monkeypatch: Patch) -> None:
    nobody_joins_later(monkeypatch)
    result = heliarch("campaign", "oahu", "--seeds", "1..2", "--set", "commitment.share=0.75")
    assert result.exit_code == 1
    commands = [line for line in result.output.splitlines() if "heliarch simulate oahu" in line]
    assert commands
    assert any(line.count("--fault") == 1 for line in commands)


def test_a_policy_that_ends_the_run_is_named() -> None:
    words = ["campaign", "oahu", "--seeds", "1..2", "--set", "restart.when=never"]
    result = heliarch(*words)
    assert result.exit_code == 1
    assert ": end, cycle" in result.output
    assert "was killed in the middle of the run" in result.output


def test_a_page_draws_the_worst_seeds(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    words = ["campaign", "oahu", "--seeds", "1..2", "--report", str(page)]
    result = heliarch(*words)
    assert result.exit_code == 0, result.output
    text = page.read_text(encoding="utf-8")
    assert "0 of 2 seeds broke an invariant" in text
    assert len(re.findall(r'id="seed-\d-plot-data"', text)) == 2
    assert re.search(r"Faults: .*(kill|freeze|partition|loss)=", text)
