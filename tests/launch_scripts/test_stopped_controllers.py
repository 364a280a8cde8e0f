"""Controllers that are killed, stand still or are cut off, in memory on a virtual clock."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import done
from memory_runs import add_zombie, run_with
from plans_by_hand import with_changes

from agents.plan import changed
from agents.settings import RestartPolicy, Revert
from bus_schemas.errors import InputError
from bus_schemas.faults import Blackout
from bus_schemas.messages import Memory
from bus_schemas.signals import IMPP, MEMORY
from bus_schemas.tree import CENTRAL, ROOT
from launch_scripts.simulation import MemoryRun, on_the_clock
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario
from scenarios.settings import with_settings

CYCLES = 150
KILLED_AT = 30


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    """17 inverters in three clusters under broken clouds."""
    return prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "stopped")


@pytest.mark.parametrize("victim", ["central", "c2", "c2/inv07"])
def test_a_killed_controller_is_replaced_and_the_plant_is_as_before(
    oahu: Preparation, victim: str
) -> None:
    nothing = "blackout=1000000s..2000000s"  # The rule puts the run on the clock.
    law = {"scheme": "paper", "correction": False}
    _, healthy = run_with(oahu, [nothing], **law)
    run, trace = run_with(oahu, [f"kill={victim},at={KILLED_AT}s"], **law)
    assert run.restarts == {victim: 1}
    successor = run.loops[victim]
    assert 0 < successor.incarnation <= KILLED_AT + 2
    apart = np.flatnonzero((trace.power_kw != healthy.power_kw).any(axis=1))
    assert len(apart) == 0 or apart.max() <= successor.incarnation + 3


def test_a_restarted_central_controller_goes_on_from_what_it_stated_last(
    oahu: Preparation,
) -> None:
    misread = changed(oahu.plan, grid={"meter_error_percent": 3.0})
    run, trace = run_with(
        dataclasses.replace(oahu, plan=misread), [f"kill=central,at={KILLED_AT}s"]
    )
    joined = run.loops[CENTRAL].incarnation
    assert joined > KILLED_AT
    stated = trace.of(MEMORY.of(ROOT))
    before = max(cycle for cycle in stated if cycle < joined)
    old, new = stated[before], stated[joined]
    assert isinstance(old, Memory)
    assert isinstance(new, Memory)
    assert abs(old.correction_kw) > 50.0, "the meter misreads, and the correction has grown"
    assert new.correction_kw == pytest.approx(old.correction_kw, rel=0.2)
    assert new.expected_kw[1:] == old.expected_kw[: len(new.expected_kw) - 1]


@pytest.mark.parametrize(
    ("policy", "restarts"),
    [(RestartPolicy(when="never"), 0), (RestartPolicy(most=2, within_s=60.0), 2)],
)
def test_a_controller_that_may_not_be_started_again_is_given_up(
    oahu: Preparation, policy: RestartPolicy, restarts: int
) -> None:
    faults = [f"kill=c2,at={at}s" for at in (30, 40, 50)]
    run, trace = run_with(oahu, faults, restart=policy)
    assert run.given_up == {"c2": 30 + 10 * restarts}
    assert run.restarts == ({"c2": restarts} if restarts else {})
    assert len(trace.power_kw) == CYCLES


def test_a_frozen_controller_goes_on_in_the_cycle_under_way(oahu: Preparation) -> None:
    run, _ = run_with(oahu, [f"freeze=c2,at={KILLED_AT}s..{KILLED_AT + 4}s"])
    loop = run.loops["c2"]
    assert (loop.finished, loop.incarnation, run.restarts) == (True, 0, {})
    assert 2 <= loop.times.skipped_cycles <= 4


def test_a_controller_that_stays_frozen_is_replaced_and_thaws_no_more(oahu: Preparation) -> None:
    freezes = f"freeze=c2,at={KILLED_AT}s..{KILLED_AT + 15}s"
    run, _ = run_with(oahu, [freezes], restart=RestartPolicy(frozen_s=8.0))
    assert run.restarts == {"c2": 1}
    assert run.loops["c2"].incarnation == KILLED_AT + 9
    run, _ = run_with(oahu, [freezes], restart=RestartPolicy(when="never"))
    assert run.loops["c2"].times.skipped_cycles >= 13, (
        "nobody kills it where nobody would replace it"
    )


def test_a_zombie_is_refused_by_who_has_heard_its_successor(oahu: Preparation) -> None:
    plan = with_changes(oahu.plan, faults=(Blackout(at=(1e6, 2e6)),))
    run = MemoryRun(on_the_clock(plan), oahu.profile)
    add_zombie(run, "c2", KILLED_AT, KILLED_AT + 40)
    list(run.cycles())
    of_zombie = CYCLES - KILLED_AT - 40
    dropped = run.loops[CENTRAL].inputs.dropped
    for signal in ("impp", "residual"):
        assert dropped[f"c2/{signal}", "wrong_sender"] == of_zombie


def test_a_tripped_inverter_draws_power_and_is_counted_on_again_afterwards(
    oahu: Preparation,
) -> None:
    tripped = slice(KILLED_AT, KILLED_AT + 40)
    _, trace = run_with(oahu, [f"trip=c2/inv07,at={KILLED_AT}s..{KILLED_AT + 40}s"])
    place = oahu.plan.tree.leaves.index("c2/inv07")
    assert (trace.power_kw[tripped, place] < 0.0).all()
    assert (np.delete(trace.power_kw, tripped, axis=0)[:, place] > 0.0).all()
    impp_kw = [message.power_kw for _, message in sorted(trace.of(IMPP.of("c2/inv07")).items())]
    assert max(impp_kw[KILLED_AT + 2 : KILLED_AT + 40]) < 1.0 < min(impp_kw[KILLED_AT + 42 :])


def test_inverters_that_a_scenario_sets_otherwise_must_exist(oahu: Preparation) -> None:
    slow = with_settings(oahu.scenario, [("plant.settings", [{"nodes": "c1/*", "delay_s": 20}])])
    found = prepare(slow, RunOptions(duration="5"), "slow").plan
    assert [found.site.follows_within_s(leaf) for leaf in ("c1/inv01", "c2/inv03")] == [20.0, 0.0]
    absent = with_settings(oahu.scenario, [("plant.settings", [{"nodes": "c9/*"}])])
    with pytest.raises(InputError, match=r"plant\.settings\[0\]\.nodes: .*c1/inv01"):
        prepare(absent, RunOptions(duration="5"), "absent")


def test_a_revert_time_leaves_controllers_three_cycles(oahu: Preparation) -> None:
    rare = prepare(oahu.scenario, RunOptions(duration="60", cycle_s=30.0), "rare")
    assert rare.plan.site.revert == Revert(after_s=90.0)
    assert any("90 s" in remark for remark in rare.remarks)


def test_a_recording_with_deaths_is_repeated_and_says_who_came_back(
    tmp_path: Path,
) -> None:
    kills = ("central,at=10.2s", "c2,at=20s", "c1/inv01,at=5s", "c1/inv05,at=500s")
    faults = ("freeze=c1,at=15s..17s", "loss=5%", *(f"kill={kill}" for kill in kills))
    words = [word for fault in faults for word in ("--fault", fault)]
    run = tmp_path / "run"
    done("simulate", "oahu", "--duration", "30s", *words, "--out", run)
    restarts = json.loads((run / "summary.json").read_bytes())["launcher"]["restarts"]
    assert restarts == {"central": 1, "c1/inv01": 1, "c2": 1}
    done("verify", run)
    inspected = " ".join(done("inspect", run).split())
    for told in (
        "c1/inv01: absent, killed in cycle 5 (12:00:05), restarted in cycle 6",
        "kill=c1/inv05,at=500s: never acted",
    ):
        assert told in inspected
