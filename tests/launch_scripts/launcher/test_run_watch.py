"""Who is silent for too long: in real time a recorder may stand still for a while."""

from __future__ import annotations

from typing import Literal

import pytest
from msgspec.structs import replace
from plans_by_hand import plan_at_noon

from agents.plan import RunPlan
from agents.settings import RestartPolicy
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.launcher.run_watch import RunWatch

PLAN = plan_at_noon()


def real_time(cycle_s: float = 0.05) -> RunPlan:
    return replace(PLAN, cycle_wall_ns=round(cycle_s * 1e9))


class Watched:
    """A run that began at 100 s, and what the user was told of it."""

    def __init__(self, plan: RunPlan) -> None:
        self.told: list[str] = []
        self.watch = RunWatch(plan, self.told.append)
        self._looked_at = 100.0
        self.watch.begin(self._looked_at)

    def blamed(self, time_s: float, step_s: float = 0.1) -> str | None:
        """Who is to blame at a time. Somebody looks every now and then up to it."""
        while self._looked_at < time_s - step_s:
            self._looked_at += step_s
            self.watch.check(self._looked_at)
        self._looked_at = time_s
        trouble = self.watch.check(time_s)
        return trouble and trouble[0]


@pytest.mark.parametrize("when", ["on-failure", "never"])
def test_a_silent_recorder_is_told_once_and_blamed_if_no_other_is_started(
    when: Literal["on-failure", "never"],
) -> None:
    run = Watched(replace(real_time(), restart=RestartPolicy(when=when)))
    assert (run.blamed(101.9), run.told) == (None, [])
    assert (run.blamed(102.1), run.blamed(109.9)) == (None, None)
    assert len(run.told) == 1
    assert (run.blamed(110.1) == RECORDER) == (when == "never")


@pytest.mark.parametrize("first_word", [7, 90])
def test_the_plant_is_not_blamed_for_what_its_recorder_did_not_tell(first_word: int) -> None:
    run = Watched(real_time())
    run.blamed(101.0)
    run.watch.hear(7)
    assert run.blamed(108.9) is None
    # The first word after the silence may be an old one.
    run.watch.hear(first_word)
    assert run.blamed(110.0) is None
    run.watch.hear(91)
    assert len(run.told) == 1
    run.blamed(113.0)
    assert len(run.told) == 2, "each silence is told"


@pytest.mark.parametrize(("cycle_s", "longest_s"), [(0.05, 5.0), (4.0, 12.0)])
def test_a_plant_that_does_not_go_on_is_found_while_its_recorder_speaks(
    cycle_s: float, longest_s: float
) -> None:
    run = Watched(real_time(cycle_s))
    for tenth in range(1, 400):
        now_s = 100.0 + tenth / 10
        run.watch.hear(3)
        if blamed := run.blamed(now_s):
            break
    assert blamed == PLANT
    assert now_s == pytest.approx(100.1 + longest_s, abs=0.11)


@pytest.mark.parametrize("plan", [PLAN, real_time()])
def test_a_launcher_that_stood_still_itself_blames_nobody_for_it(plan: RunPlan) -> None:
    run = Watched(plan)
    run.blamed(101.0)
    assert run.watch.check(131.0) is None, "stopped for 30 s, and nothing heard meanwhile"
    assert run.told == []


def test_a_launcher_that_is_always_slow_finds_the_silent_one_too() -> None:
    assert Watched(PLAN).blamed(103.0, step_s=0.6) == RECORDER
