"""Controllers that are killed, stand still or are cut off, in memory on a virtual clock."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import done
from memory_runs import run_with

from agents.settings import RestartPolicy, Revert
from bus_schemas.errors import InputError
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario
from scenarios.settings import with_settings

CYCLES = 150


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    """17 inverters in three clusters under broken clouds."""
    return prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "stopped")


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


def test_of_two_freezes_each_has_its_own_time_after_which_the_process_is_replaced(
    oahu: Preparation,
) -> None:
    for until, restarts in ((40, {}), (49, {"c2": 1})):
        faults = ["freeze=c2,at=30s..33s", f"freeze=c2,at=36s..{until}s"]
        run, _ = run_with(oahu, faults, restart=RestartPolicy(frozen_s=8.0))
        assert run.restarts == restarts


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
    restarts = json.loads((run / "summary.json").read_bytes())["restarts"]
    assert restarts == {"central": 1, "c1/inv01": 1, "c2": 1}
    done("verify", run)
    inspected = " ".join(done("inspect", run).split())
    for told in (
        "c1/inv01: absent, killed in cycle 5 (12:00:05), restarted in cycle 6",
        "kill=c1/inv05,at=500s: never acted",
    ):
        assert told in inspected
