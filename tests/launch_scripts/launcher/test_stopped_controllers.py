"""Controllers that are killed, stand still or are cut off, in memory on a virtual clock."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import inf

import numpy as np
import pytest
from memory_runs import Sent, run_with
from numpy.typing import NDArray

from agents.settings import RestartPolicy, Revert
from bus_schemas.errors import InputError
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.launcher.supervision import RunFailure
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.compare.cases import with_settings

CYCLES = 150
KILLED_AT = 30
NEVER = inf
NOTHING = "silent=1000000s..2000000s"
"""A rule that puts a run on the clock, and does nothing."""


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    """17 inverters in three clusters under broken clouds."""
    return prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "stopped")


def run_through(
    prepared: Preparation, *faults: str, restart_takes_s: float = 0.5, **changes: object
) -> tuple[MemoryRun, Sent]:
    """Run through with fault rules as `--fault` reads them, always on the clock."""
    return run_with(prepared, faults or (NOTHING,), restart_takes_s, **changes)


@pytest.fixture(scope="module")
def healthy(oahu: Preparation) -> Callable[..., Sent]:
    """The run without faults, by actuator or scheme."""
    return cache(lambda **changes: run_through(oahu, **changes)[1])


def longest_above(over_kw: NDArray[np.float64], limit_kw: float) -> int:
    """Most cycles in a row in which a limit is exceeded."""
    longest = now = 0
    for is_above in over_kw > limit_kw:
        now = now + 1 if is_above else 0
        longest = max(longest, now)
    return longest


@pytest.mark.parametrize(
    "fault",
    [
        *(f"kill={victim},at={KILLED_AT}s" for victim in ("central", "c2", "c2/inv07", "c2/*")),
        f"partition=c2|central,at={KILLED_AT}s..{KILLED_AT + 20}s",
    ],
)
@pytest.mark.parametrize("actuator", ["fraction", "limit"])
def test_without_a_controller_the_plant_hardly_delivers_too_much(
    oahu: Preparation, healthy: Callable[..., Sent], fault: str, actuator: str
) -> None:
    run, trace = run_through(oahu, fault, restart_takes_s=NEVER, actuator=actuator)
    beyond_kw = trace.over_kw - np.maximum(healthy(actuator=actuator).over_kw, 0.0)
    assert longest_above(beyond_kw, 0.05 * oahu.plan.tree.rating_kw("")) <= 3
    if fault.startswith("partition"):
        both_ways = [run.loops[name].old_inputs > 0 for name in ("c2", "central")]
        assert both_ways == [True, True]


@pytest.mark.parametrize("victim", ["central", "c2", "c2/inv07"])
def test_a_killed_controller_is_replaced_and_the_plant_is_as_before(
    oahu: Preparation, healthy: Callable[..., Sent], victim: str
) -> None:
    run, trace = run_through(oahu, f"kill={victim},at={KILLED_AT}s", scheme="paper")
    assert run.restarts == {victim: 1}
    successor = run.loops[victim]
    assert 0 < successor.incarnation <= KILLED_AT + 2
    apart = np.flatnonzero((trace.power_kw != healthy(scheme="paper").power_kw).any(axis=1))
    assert len(apart) == 0 or apart.max() <= successor.incarnation + 3


@pytest.mark.parametrize(
    ("policy", "kills", "ended_by"),
    [
        (RestartPolicy(when="never"), [30], "never"),
        (RestartPolicy(most=2, within_s=60.0), [30, 40, 50], "2 times within 60 s"),
        (RestartPolicy(most=2, within_s=15.0), [30, 40, 50], None),
    ],
)
def test_a_controller_that_may_not_be_started_again_ends_the_run(
    oahu: Preparation, policy: RestartPolicy, kills: list[int], ended_by: str | None
) -> None:
    faults = [f"kill=c2,at={at}s" for at in kills]
    if ended_by is None:
        run, _ = run_through(oahu, *faults, restart=policy)
        assert run.restarts == {"c2": len(kills)}
        return
    with pytest.raises(RunFailure, match=f"^c2 .*{ended_by}"):
        run_through(oahu, *faults, restart=policy)


def test_a_frozen_controller_goes_on_in_the_cycle_under_way(oahu: Preparation) -> None:
    run, _ = run_through(oahu, f"freeze=c2,at={KILLED_AT}s..{KILLED_AT + 4}s")
    loop = run.loops["c2"]
    assert (loop.finished, loop.incarnation, run.restarts) == (True, 0, {})
    assert 2 <= loop.skipped_cycles <= 4


def test_a_controller_that_stays_frozen_is_replaced_and_thaws_no_more(oahu: Preparation) -> None:
    freezes = f"freeze=c2,at={KILLED_AT}s..{KILLED_AT + 15}s"
    run, _ = run_through(oahu, freezes, restart=RestartPolicy(frozen_s=8.0))
    assert run.restarts == {"c2": 1}
    assert run.loops["c2"].incarnation == KILLED_AT + 9
    run, _ = run_through(oahu, freezes, restart=RestartPolicy(when="never"))
    assert run.loops["c2"].skipped_cycles >= 13, "nobody kills it where nobody would replace it"


@pytest.mark.parametrize("actuator", ["fraction", "limit"])
def test_inverters_that_hear_nothing_revert_to_their_share_of_the_last_dispatch(
    oahu: Preparation, actuator: str
) -> None:
    changes = {"actuator": actuator, "revert": Revert(after_s=60.0)}
    _, trace = run_through(oahu, f"kill=*,at={KILLED_AT}s", restart_takes_s=NEVER, **changes)
    last_desired_kw = trace.produced[KILLED_AT].desired_kw
    limit_kw = last_desired_kw * rating_kw(oahu) / oahu.plan.tree.rating_kw("")
    expected_kw = np.minimum(oahu.profile.mpp_kw, limit_kw)
    reverted = slice(KILLED_AT + 62, CYCLES)
    np.testing.assert_allclose(trace.power_kw[reverted], expected_kw[reverted], rtol=2e-3)


def rating_kw(prepared: Preparation) -> NDArray[np.float64]:
    return np.array([rating for _, rating in prepared.plan.inverters])


def test_inverters_that_a_scenario_sets_otherwise_must_exist(oahu: Preparation) -> None:
    slow = with_settings(oahu.scenario, ('plant.settings=[{nodes="c1/*", delay_s=20}]',))
    found = prepare(slow, RunOptions(duration="5"), "slow").plan
    assert [found.follows_within_s(leaf) for leaf in ("c1/inv01", "c2/inv03")] == [20.0, 0.0]
    absent = with_settings(oahu.scenario, ('plant.settings=[{nodes="c9/*"}]',))
    with pytest.raises(InputError, match=r"plant\.settings\[0\]\.nodes: .*c1/inv01"):
        prepare(absent, RunOptions(duration="5"), "absent")


def test_a_revert_time_leaves_controllers_three_cycles(oahu: Preparation) -> None:
    rare = prepare(oahu.scenario, RunOptions(duration="60", cycle_s=30.0), "rare")
    assert rare.plan.revert == Revert(after_s=90.0)
    assert any("90 s" in remark for remark in rare.remarks)
