"""Who is unresponsive, and which external agents are there."""

from __future__ import annotations

from typing import Any, Literal

import pytest
from plans_by_hand import REAL_TIME, plan_at_noon

from agents.process.events import Presence, Status
from agents.settings import RestartPolicy
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.watch import Row, Watch

NODE = "c1/a"
FAST = REAL_TIME // 20


class Watched:
    """A run that began at 100 s, and what the user was told of it."""

    def __init__(self, **changes: Any) -> None:
        self.told: list[str] = []
        self.now_s = 100.0
        plan = plan_at_noon(**changes)
        own = {name: Row(name) for name in plan.processes if name not in plan.elsewhere}
        self.watch = Watch(plan, own, self.told.append, lambda: self.now_s)
        self.watch.begin()

    def blamed(self, time_s: float, step_s: float = 0.1) -> str | None:
        """Who is to blame at a time. The launcher looks every now and then up to it."""
        while self.now_s < time_s - step_s:
            self.now_s += step_s
            self.watch.failure()
        self.now_s = time_s
        failure = self.watch.failure()
        return failure and failure[0]

    def report(self, cycle: int) -> None:
        """Let the recorder say where the run stands."""
        self.watch.hear(Status(cycle, 0, 0.0, 0.0, 0.0, [], 0))

    def token(self, agent: str, cycle: int, *, alive: bool = True) -> str:
        """Let a token appear or disappear; return what the user was told."""
        self.watch.hear(Presence(agent, alive, cycle))
        return self.told[-1]


@pytest.mark.parametrize("when", ["on-failure", "never"])
def test_an_unresponsive_recorder_is_told_once_and_blamed_if_no_other_is_started(
    when: Literal["on-failure", "never"],
) -> None:
    run = Watched(cycle_wall_ns=FAST, restart=RestartPolicy(when=when))
    assert (run.blamed(101.9), run.told) == (None, [])
    assert (run.blamed(102.1), run.blamed(109.9)) == (None, None)
    assert len(run.told) == 1
    assert (run.blamed(110.1) == RECORDER) == (when == "never")


@pytest.mark.parametrize("first_cycle", [7, 90])
def test_the_plant_is_not_blamed_for_what_its_recorder_did_not_tell(first_cycle: int) -> None:
    run = Watched(cycle_wall_ns=FAST)
    run.blamed(101.0)
    run.report(7)
    assert run.blamed(108.9) is None
    for tenth in range(46):  # The first report after that may be an old one.
        run.report(first_cycle)
        assert run.blamed(109.0 + tenth / 10) is None
    run.report(91)
    assert len(run.told) == 1
    run.blamed(116.0)
    assert len(run.told) == 2, "each time is told"


@pytest.mark.parametrize(("cycle_s", "longest_s"), [(0.05, 5.0), (4.0, 12.0)])
def test_a_plant_that_does_not_go_on_is_found_while_its_recorder_reports(
    cycle_s: float, longest_s: float
) -> None:
    run = Watched(cycle_wall_ns=round(cycle_s * 1e9))
    for tenth in range(1, 400):
        run.report(3)
        if blamed := run.blamed(100.0 + tenth / 10):
            break
    assert blamed == PLANT
    assert run.now_s == pytest.approx(100.1 + longest_s, abs=0.11)


@pytest.mark.parametrize("changes", [{}, {"cycle_wall_ns": FAST}])
def test_a_launcher_that_stood_still_itself_blames_nobody_for_it(changes: dict[str, Any]) -> None:
    run = Watched(**changes)
    run.blamed(101.0)
    run.now_s = 131.0
    assert run.watch.failure() is None, "stopped for 30 s, and nothing heard meanwhile"
    assert run.told == []


def test_a_launcher_that_is_always_slow_finds_the_unresponsive_one_too() -> None:
    assert Watched().blamed(103.0, step_s=0.6) == RECORDER


def test_external_agents_are_awaited_until_each_was_seen_once() -> None:
    run = Watched(external=(NODE, "central"))
    run.token(NODE, -1)
    assert (run.watch.complete_at, run.watch.awaited) == (None, ["central"])
    run.now_s = 161.0
    assert run.token("central", -1).endswith("is here")
    assert (run.watch.complete_at, run.watch.awaited) == (161.0, [])


@pytest.mark.parametrize(
    ("agent", "changes", "gone"),
    [
        ("plant", {}, [True, True]),
        (NODE, {}, [True, True]),
        ("plant", {"cycle_wall_ns": REAL_TIME}, [True, False]),
        (NODE, {"cycle_wall_ns": REAL_TIME}, [False, False]),
    ],
)
def test_a_run_fails_without_its_plant_and_in_lockstep_after_the_loss_of_any_device(
    agent: str, changes: dict[str, Any], gone: list[bool]
) -> None:
    for come_back in (False, True):
        run = Watched(external=(agent,), **changes)
        assert run.token(agent, -1).endswith("is here")
        assert "goes on" not in run.token(agent, -1, alive=False)
        # The recorder may tell of a return, or of its first sign, only when cycles have begun.
        assert "is back" in run.token(agent, 3)
        run.token(agent, 41, alive=False)
        if come_back:
            run.token(agent, 42)
        blamed = None
        for tenth in range(1, 30):
            run.report(tenth)
            blamed = blamed or run.blamed(100.0 + tenth / 10)
        assert (blamed == agent) == gone[come_back]
