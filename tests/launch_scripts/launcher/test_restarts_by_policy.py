"""Who is killed for saying nothing, and how often processes are started again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec.structs import replace
from plans_by_hand import REAL_TIME, plan_at_noon

from agents.events import Exited, Standing, Status, TookOver
from agents.plan import RunPlan
from launch_scripts.launcher.restarts import Restarts
from launch_scripts.launcher.supervision import Child

PLAN = plan_at_noon(cycle_wall_ns=REAL_TIME, standby=("c1",))
"""Cycles of 1 s in real time; who says nothing for 5 s is killed."""


NOBODY = 2**31 - 1
"""No process has this number."""


class Watched:
    """A run whose processes say what the test says for them."""

    def __init__(self, plan: RunPlan) -> None:
        self.now_s = 1000.0
        self.said: list[str] = []
        self.started: list[str] = []
        names = ("plant", "recorder", "central", "c1", "c1+standby", "c2")
        self.by_agent = {name: self.child(name) for name in names}
        self.restarts = Restarts(
            plan, cast("Any", self), self.started.append, self.said.append, lambda: self.now_s
        )
        self.restarts.begin(self.now_s)

    def child(self, name: str) -> Child:
        kinds = {"plant": "plant", "recorder": "recorder", "central": "central"}
        child = Child(name, cast("Any", kinds.get(name, "supervisor")), Path("log"))
        child.pid = NOBODY
        return child

    def __getitem__(self, name: str) -> Child:
        return self.by_agent[name]

    def controllers(self) -> list[Child]:
        return [child for name, child in self.by_agent.items() if name != "recorder"]

    def pass_by(self, seconds: float, *silent: str, step_s: float = 0.25) -> None:
        """Let time pass in which the recorder names these as silent."""
        status = Status(7, 0, 0.0, 0.0, 0.0, [], 0, silent=list(silent))
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.restarts.hear(self["recorder"], status)
            self.restarts.look(0.0)

    @property
    def killed(self) -> Sequence[str]:
        return [text.split()[0] for text in self.said if "killed" in text]


@pytest.fixture
def run() -> Watched:
    return Watched(PLAN)


@pytest.mark.parametrize("cycle_s", [1, 60])
def test_a_controller_that_says_nothing_is_named_and_killed_however_long_cycles_are(
    cycle_s: int,
) -> None:
    watched = Watched(replace(PLAN, cycle_wall_ns=cycle_s * REAL_TIME))
    for killed in ([], ["c2"]):
        for _ in range(8):
            watched.now_s += 0.25
            watched.restarts.note_silence(["c2"], 2.0)
        assert watched.killed == killed
    assert watched.said[0].startswith("c2 (process")


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
        run.restarts.hear(run["c1+standby"], Standing())
    assert run.killed == []
    run.pass_by(8.0)
    assert run.killed == ["c1+standby"]


def test_after_a_takeover_the_other_process_is_the_one_that_must_be_there(run: Watched) -> None:
    run.restarts.hear(run["c1+standby"], TookOver(7))
    assert run.restarts.takeovers == {"c1": 1}
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
