"""Which controllers are killed as unresponsive, and how often processes are started again."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import pytest
from plans_by_hand import REAL_TIME, plan_at_noon, with_changes

from agents.plan import RunPlan
from agents.process.events import Exited, Started, Status, TookOver
from launch_scripts.restarts import Restarts
from launch_scripts.supervision import Child
from launch_scripts.watch import Row, Watch

PLAN = plan_at_noon(cycle_wall_ns=REAL_TIME, standby=("c1",))
"""Cycles of 1 s in real time; a process that says nothing for 5 s is killed."""

KINDS = {"plant": "plant", "recorder": "recorder", "central": "central"}
SOME_PID = 4711


class Watched:
    """A run whose processes say what the test says for them, and what they were sent."""

    def __init__(self, plan: RunPlan) -> None:
        self.now_s = 1000.0
        self.said: list[str] = []
        self.started: list[str] = []
        self.sent: list[tuple[str, signal.Signals]] = []
        self.by_agent = {
            name: Child(name, cast("Any", KINDS.get(name, "supervisor")), Path("log"), Row(name))
            for name in ("plant", "recorder", "central", "c1", "c1+standby", "c2")
        }
        for child in self.by_agent.values():
            child.note(Started(SOME_PID))
        rows = {name: child.row for name, child in self.by_agent.items()}
        self.watch = Watch(plan, rows, self.said.append, lambda: self.now_s)
        self.restarts = Restarts(
            plan,
            cast("Any", self),
            self.watch,
            self.started.append,
            self.said.append,
            lambda: self.now_s,
        )
        self.watch.begin()
        self.restarts.begin(self.now_s)

    def __getitem__(self, name: str) -> Child:
        return self.by_agent[name]

    def signal(self, agents: Sequence[str], number: signal.Signals) -> None:
        """Send a signal, as `Children` does."""
        self.sent += [(agent, number) for agent in agents]

    def pass_by(self, seconds: float, *names: str, step_s: float = 0.25) -> None:
        """Let time pass in which the recorder names these as unresponsive."""
        status = Status(7, 0, 0.0, 0.0, 0.0, [], 0, unresponsive=list(names))
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.watch.hear(status)
            self.restarts.hear(self["recorder"], status)
            self.restarts.look()

    @property
    def killed(self) -> list[str]:
        return [name for name, number in self.sent if number == signal.SIGKILL]


@pytest.fixture
def run() -> Watched:
    return Watched(PLAN)


@pytest.mark.parametrize("cycle_s", [1, 60])
def test_a_controller_that_says_nothing_is_named_and_killed_however_long_cycles_are(
    cycle_s: int,
) -> None:
    watched = Watched(with_changes(PLAN, cycle_wall_ns=cycle_s * REAL_TIME))
    for killed in ([], ["c2"]):
        for _ in range(8):
            watched.now_s += 0.25
            watched.restarts.judge(["c2"], 2.0)
        assert watched.killed == killed
    assert watched.said[0].startswith("c2 ")


def test_a_process_that_was_killed_as_unresponsive_is_killed_again_after_its_restart(
    run: Watched,
) -> None:
    for times in (1, 2):
        run.pass_by(5.0, "c2")
        assert run.killed.count("c2") == times
        assert dies(run, "c2")
        run["c2"].note(Started(SOME_PID))
        run.pass_by(1.0)


def test_one_that_is_heard_in_between_is_not(run: Watched) -> None:
    for _ in range(2):
        run.pass_by(2.5, "c2")
        run.pass_by(0.25)
    assert run.killed == []


def test_a_machine_that_stood_still_proves_nothing(run: Watched) -> None:
    run.pass_by(60.0, "central", "c1", "c2", step_s=60.0)
    run.pass_by(0.25, "central", "c1", "c2")
    run.pass_by(0.25)
    assert run.killed == []


def test_a_process_that_stands_by_need_not_be_heard_but_must_say_that_it_is_there(
    run: Watched,
) -> None:
    for _ in range(10):
        run.pass_by(1.0)
        run["c1+standby"].row.hear(run.now_s)
    assert run.killed == []
    run.pass_by(8.0)
    assert run.killed == ["c1+standby"]


def test_after_a_takeover_the_other_process_is_the_one_that_must_be_there(run: Watched) -> None:
    run.restarts.hear(run["c1+standby"], TookOver(7))
    run.pass_by(8.0)
    assert run.killed == ["c1"]


def dies(run: Watched, name: str) -> bool:
    run[name].exited = Exited(-9, 0.0)
    return run.restarts.replaces(run[name], f"{name} was killed by signal 9")


def test_each_restart_within_the_time_waits_longer_until_there_are_enough(run: Watched) -> None:
    for number, wait_s in enumerate((0.0, 0.5, 1.0, 2.0, 4.0), start=1):
        assert dies(run, "c2")
        run.pass_by(wait_s)
        assert run.started == ["c2"] * number
    assert not dies(run, "c2")
    run.pass_by(60.0)
    assert dies(run, "c2")


def test_at_the_end_only_those_may_be_away_that_the_launcher_killed_or_has_not_started_yet(
    run: Watched,
) -> None:
    assert [dies(run, "c2"), dies(run, "c2")] == [True, True]  # The second restart is to wait.
    for name in ("c1", "c1+standby"):  # Both take over at once: the standby is killed.
        run.restarts.hear(run[name], TookOver(7))
    run.restarts.end()
    assert run.started == ["c2"]
    assert run["c2"].exited is not None
    assert dies(run, "c2")
    assert dies(run, "c1+standby")
    assert not dies(run, "central")
