"""Several agents in one process: they decide, fail and come back as agents do."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path

import pytest
from running import Heliarch, Start, small_plant
from test_launch import decided, decisions, summary_of
from verifying import assert_equal_as_far_as_recorded

from agents.plan import load_plan
from bus_schemas.messages import parse_missing
from bus_schemas.signals import IMPP
from recordings.read.reader import RunReader
from recordings.verify.verification import verify
from results.run_summary import RunSummary

pytestmark = pytest.mark.processes

GROUPED = ("--set", "processes=cluster")
GROUP = ("c2", "c2/inv03", "c2/inv04")


@pytest.fixture(scope="module")
def tall(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A plant of four tiers, of which the upper ones act rarely."""
    tiers = "cluster_sizes = [[1, 1, 2], [2, 1]]\nperiod_cycles = [6, 3, 1]"
    changes = ("cluster_sizes = [[2, 2]]", tiers), ("share = 0.5", "share = 1.1")
    return small_plant(tmp_path_factory.mktemp("tall"), *changes)


@pytest.mark.parametrize(("processes", "number"), [("cluster", 8), ('["z2"]', 9)])
def test_agents_in_one_process_decide_bit_for_bit_what_they_decide_alone(
    tall: str, tmp_path: Path, processes: str, number: int
) -> None:
    words = (tall, "--duration", "40", "--set", f"processes={processes}")
    ours = decided(tmp_path / "launched", "launch", *words)
    assert ours == decided(tmp_path / "simulated", "simulate", *words)
    summary = summary_of(tmp_path / "launched")
    assert len(load_plan(tmp_path / "launched" / "plan.json").processes) == number
    assert len(summary.processes) == number
    assert (summary.lost, summary.launcher.dropped) == (0, {})


REAL_TIME = ("--duration", "1h", "--pace", "10")
LOCKSTEP = ("--duration", "2h", "--set", "restart.when=on-failure")


@pytest.mark.parametrize("words", [REAL_TIME, LOCKSTEP])
def test_a_killed_group_comes_back_as_a_whole(
    heliarch: Start, plant: str, words: Sequence[str]
) -> None:
    run = heliarch("launch", plant, *words, *GROUPED)
    run.until_recorded()
    run.process_of("c2").send_signal(signal.SIGKILL)
    for agent in GROUP:
        run.until_back(agent)
    assert ended(run).launcher.restarts == dict.fromkeys(GROUP, 1)
    assert_equal_as_far_as_recorded(run, verify(run.folder))


def test_a_group_that_does_not_come_back_is_given_up_as_a_whole(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "2h", *GROUPED)
    run.until_recorded()
    run.process_of("c2").send_signal(signal.SIGKILL)
    run.until_shown("the run goes on without c2")
    run.until_recorded(run.recorded_cycles() + 100)
    assert ended(run, status=1).launcher.given_up.keys() == {*GROUP}


def test_faults_act_on_the_links_inside_a_group(heliarch: Start, plant: str) -> None:
    rule = "partition=c1/inv01|c1,at=20s..40s"
    run = heliarch("launch", plant, *REAL_TIME, *GROUPED, "--fault", rule)
    run.until_recorded(60)
    ended(run)
    with RunReader(run.folder) as reader:
        lacks = {
            message.cycle: any(
                key == "c1/inv01/residual" for key, _ in map(parse_missing, message.missing)
            )
            for _, message in reader.messages(IMPP, nodes="c1")
        }
    during = [lacks[cycle] for cycle in lacks if 20 <= cycle < 40]
    assert during
    assert all(during)
    assert not all(lacks.values())


def test_another_host_runs_a_cluster_as_one_process(heliarch: Start, plant: str) -> None:
    words = ("launch", plant, "--duration", "40", *GROUPED)
    run = heliarch(*words, "--on", "127.0.0.2=c2/*")
    plan = run.folder / "plan.json"
    run.until(plan.exists, "its plan")
    node = heliarch("node", "--plan", plan, "--host", "127.0.0.2")
    assert (node.wait(), run.wait()) == (0, 0), node.error_text() + run.error_text()
    assert [path.name for path in (node.folder / "logs").iterdir()] == ["c2.log"]
    assert decisions(run.folder) == decided(
        run.folder.with_name("simulated"), "simulate", *words[1:]
    )


def ended(run: Heliarch, status: int = 130) -> RunSummary:
    """End a run after the cycle under way; return its summary."""
    assert run.interrupt() == status, run.error_text()
    return summary_of(run.folder)
