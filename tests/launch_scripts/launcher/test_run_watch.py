"""Who is silent for too long: in real time a recorder may stand still for a while."""

from __future__ import annotations

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

    def blamed(self, *times_s: float) -> list[str]:
        """Who is to blame at each of some times. Somebody looks ten times a second up to them."""
        found = [self._look_up_to(time_s) for time_s in times_s]
        return [trouble[0] for trouble in found if trouble is not None]

    def _look_up_to(self, time_s: float) -> tuple[str, str] | None:
        while self._looked_at < time_s - 0.1:
            self._looked_at += 0.1
            self.watch.check(self._looked_at)
        self._looked_at = time_s
        return self.watch.check(time_s)


@pytest.mark.parametrize(
    ("policy", "next_step"),
    [
        (RestartPolicy(), "for 5 s, it is killed and started again"),
        (RestartPolicy(when="never"), "for 10 s, the run ends"),
        (RestartPolicy(frozen_s=20.0), "for 20 s, it is killed and started again"),
    ],
)
def test_a_silent_recorder_is_told_once_with_what_happens_next_by_the_restart_policy(
    policy: RestartPolicy, next_step: str
) -> None:
    run = Watched(replace(real_time(), restart=policy))
    assert run.blamed(101.9) == run.told == []
    assert run.blamed(102.1, 105.5, 109.9) == []
    (told,) = run.told
    assert "for 2 s" in told
    assert next_step in told
    assert (run.blamed(110.1) == [RECORDER]) == (policy.when == "never")


@pytest.mark.parametrize("first_word", [7, 90])
def test_the_plant_is_not_blamed_for_what_its_recorder_did_not_tell(first_word: int) -> None:
    run = Watched(real_time())
    run.watch.hear(7, 101.0)
    assert run.blamed(103.5, 108.9) == []
    # The first word after the silence may be an old one.
    run.watch.hear(first_word, 109.0)
    assert run.blamed(109.1) == []
    run.watch.hear(91, 110.0)
    assert run.blamed(110.1) == []
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
        run.watch.hear(3, now_s)
        if blamed := run.blamed(now_s):
            break
    assert blamed == [PLANT]
    assert now_s == pytest.approx(100.1 + longest_s, abs=0.11)


@pytest.mark.parametrize("plan", [PLAN, real_time()])
def test_a_launcher_that_stood_still_itself_blames_nobody_for_it(plan: RunPlan) -> None:
    run = Watched(plan)
    assert run.blamed(101.0) == []
    assert run.watch.check(131.0) is None, "stopped for 30 s, and nothing heard meanwhile"
    assert run.told == []
    run.watch.hear(7, 131.1)
    assert run.watch.check(131.2) is None


def test_a_launcher_that_is_always_slow_finds_the_silent_one_too() -> None:
    run = Watched(PLAN)
    found = [run.watch.check(100.0 + 0.6 * look) for look in range(30)]
    assert found[-1] is not None
    assert found[-1][0] == RECORDER
