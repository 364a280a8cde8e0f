"""Standbys of parents, in memory on a virtual clock: they take over within one cycle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import done
from memory_runs import run_with

from bus_schemas.messages import Takeover
from bus_schemas.signals import SETPOINT
from bus_schemas.tree import CENTRAL
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

CYCLES = 60
PARENTS = ("central", "c1", "c2", "c3")


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "standby")


class Run:
    """A run with a standby of each parent, and what was sent."""

    def __init__(self, prepared: Preparation, *faults: str, **changes: object) -> None:
        changed: dict[str, Any] = {"standby": PARENTS, **changes}
        self.memory, sent = run_with(prepared, faults, **changed)
        self.sent = sent.messages

    @property
    def takeovers(self) -> list[tuple[str, int]]:
        return [(one.source, one.cycle) for _, one in self.sent if isinstance(one, Takeover)]

    def setpoints_of(self, agent: str) -> dict[int, set[int]]:
        """The incarnations that sent setpoints, cycle by cycle."""
        found: dict[int, set[int]] = {}
        for port, message in self.sent:
            if port.signal is SETPOINT and message.source == agent:
                found.setdefault(message.cycle, set()).add(message.incarnation)
        return found

    @property
    def missed(self) -> int:
        return sum(loop.missing_inputs for loop in self.memory.loops.values())


@pytest.mark.parametrize("victim", ["central", "c2"])
@pytest.mark.parametrize("at_s", [20.0, 20.8])
@pytest.mark.parametrize("deadlines_ms", [(), (500, 540, 800), (500, 800, 840)])
def test_nobody_misses_a_parent_that_has_a_standby(
    oahu: Preparation, victim: str, at_s: float, deadlines_ms: tuple[int, ...]
) -> None:
    tiers_ns = tuple(deadline * 1_000_000 for deadline in deadlines_ms)
    run = Run(oahu, f"kill={victim},at={at_s}s", tier_deadlines_ns=tiers_ns)
    ((agent, cycle),) = run.takeovers
    assert (agent, cycle in {20, 21}) == (victim, True)
    setpoints = run.setpoints_of(victim)
    assert setpoints == {k: {0 if k < cycle else cycle} for k in range(CYCLES)}
    assert run.missed == 0


def test_without_a_standby_it_is_missed(oahu: Preparation) -> None:
    assert Run(oahu, "kill=c2,at=20s", standby=()).missed > 0


def test_it_goes_on_with_what_the_other_process_knew(oahu: Preparation) -> None:
    faults = ("delay=1ms",)
    healthy = Run(oahu, *faults)
    run = Run(oahu, *faults, "kill=central,at=40s")
    assert healthy.takeovers == []
    decided = [
        [message.power_kw for port, message in one.sent if port.signal is SETPOINT]  # type: ignore[attr-defined]
        for one in (healthy, run)
    ]
    assert decided[0] == decided[1]


def test_one_that_stood_still_is_refused_and_stands_by(oahu: Preparation) -> None:
    run = Run(oahu, "freeze=c2,at=20s..23s", "kill=c2,at=40s")
    assert run.takeovers == [("c2", 20), ("c2", 40)]
    loops = run.memory.loops
    assert not loops["c2"].silent, "the first process speaks again, after the second one was killed"
    assert loops["c2+standby"].silent
    assert run.missed == 0


def test_where_both_are_gone_one_takes_over_after_its_return(oahu: Preparation) -> None:
    run = Run(oahu, "kill=c2,at=20s", "kill=c2,at=20.8s")
    assert [agent for agent, _ in run.takeovers] == ["c2", "c2"]
    assert run.memory.restarts == {"c2": 1, "c2+standby": 1}
    speaking = [name for name in ("c2", "c2+standby") if not run.memory.loops[name].silent]
    assert len(speaking) == 1
    assert all(len(incarnations) == 1 for incarnations in run.setpoints_of("c2").values())


def test_an_agent_cut_off_from_others_keeps_its_process(oahu: Preparation) -> None:
    run = Run(oahu, f"partition=c2|{CENTRAL},at=20s..30s", "loss=20%")
    assert run.takeovers == []


def test_a_recording_with_deaths_is_repeated_and_says_who_took_over_or_came_back(
    tmp_path: Path,
) -> None:
    kills = ("central,at=10.2s", "c2,at=20s", "c1/inv01,at=5s", "c1/inv05,at=500s")
    faults = ("freeze=c1,at=15s..17s", "loss=5%", *(f"kill={kill}" for kill in kills))
    words = [word for fault in faults for word in ("--fault", fault)]
    words += ["--set", 'standby=["central","supervisors"]']
    run = tmp_path / "run"
    done("simulate", "oahu", "--duration", "30s", *words, "--out", run)
    takeovers = json.loads((run / "summary.json").read_bytes())["takeovers"]
    assert takeovers == {"central": 1, "c1": 1, "c2": 1}
    done("verify", run)
    inspected = " ".join(done("inspect", run).split())
    for told in (
        "c1: its standby took over in cycle 15",
        "c1/inv01: nothing in cycle 5 (12:00:05), restarted in cycle 6",
        "kill=c1/inv05,at=500s: never acted",
    ):
        assert told in inspected
