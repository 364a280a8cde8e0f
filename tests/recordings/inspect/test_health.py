"""The health of a run names what was lost, who was absent and what only the launcher knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from memory_runs import run_in_memory
from msgspec.structs import replace
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, numbered, whole_run, write_messages, write_run
from reports_by_hand import summary_of

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import HELP
from recordings.inspect.agent_states import AgentSpan, states_of
from recordings.inspect.overview import Overview, read_overview
from recordings.read.reader import RunReader
from recordings.read.run_file import FAILURE_NAME, SUMMARY_NAME
from results.health_lines import health_lines
from results.run_document import WrongMessages, outcome_of
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

CYCLES = 60
DEVICE = "c2/c"


def health_of(folder: Path) -> tuple[Overview, str]:
    with RunReader(folder) as run:
        health = read_overview(run)
        return health, "\n".join(
            f"{name}: {text}" for name, text in health_lines(health, run.clock, outcome_of(run))
        )


def written(
    folder: Path,
    is_published: Callable[[Delivery], bool] = lambda pair: True,
    is_kept: Callable[[Delivery], bool] = lambda pair: True,
) -> tuple[Overview, str]:
    write_run(folder / "run.mcap", filter(is_published, whole_run(CYCLES)), is_kept=is_kept)
    return health_of(folder)


def test_a_sound_run_has_nothing_to_report(tmp_path: Path) -> None:
    health, text = written(tmp_path)
    assert (health.messages_lost, health.repeated, health.misses, health.states) == (0, 0, (), ())
    assert health.stop_cycle == CYCLES
    assert "not recorded" in text, "how many messages were dropped, only the launcher knows"


def joined_in_cycle_20(agent: str, is_kept: Callable[[Delivery], bool]) -> Iterator[Delivery]:
    """A run in which an agent is another process from cycle 20 on."""

    def is_new(message: Message) -> bool:
        return message.source == agent and message.cycle >= 20

    for port, message in numbered(whole_run(CYCLES), lambda pair: is_new(pair[1])):
        message.incarnation = 20 * is_new(message)
        if is_kept((port, message)):
            yield port, message


def test_a_restart_is_told_once_whenever_a_rare_message_follows(tmp_path: Path) -> None:
    def is_kept(pair: Delivery) -> bool:
        return pair[0].signal is not HELP or not 20 <= pair[1].cycle < 40

    write_messages(tmp_path / "run.mcap", joined_in_cycle_20("c1/a", is_kept))
    health, text = health_of(tmp_path)
    assert health.states == (AgentSpan("c1/a", "absent", 20, 0, is_restarted=True, back_in=20),)
    assert "c1/a: restarted in cycle 20" in text


def test_a_process_that_joined_while_nobody_recorded_is_told_with_its_cycle(
    tmp_path: Path,
) -> None:
    deliveries = joined_in_cycle_20("c2", lambda pair: not 15 <= pair[1].cycle < 30)
    write_messages(tmp_path / "run.mcap", deliveries)
    health, text = health_of(tmp_path)
    assert set(health.states) == {
        AgentSpan("c2", "absent", 20, 0, is_restarted=True, back_in=20),
        AgentSpan("recorder", "cut off", 15, 15, back_in=30),
    }
    assert "recorder: cut off in cycles 15 to 29" in text


def test_a_device_that_runs_ahead_does_not_make_the_recorder_absent(tmp_path: Path) -> None:
    plan = with_changes(PLAN, external=(DEVICE,))
    run = list(numbered(whole_run(CYCLES)))
    ahead = next(pair for pair in run if pair[1].source == DEVICE and pair[1].cycle == 50)
    write_messages(tmp_path / "run.mcap", [*run[:400], ahead, *run[400:]], plan=plan)
    assert "recorder" not in {span.agent for span in health_of(tmp_path)[0].states}


def test_an_agent_whose_messages_were_lost_for_long_was_not_heard(tmp_path: Path) -> None:
    gone = range(20, 40)
    health, text = written(
        tmp_path, is_kept=lambda pair: pair[1].source != "central" or pair[1].cycle not in gone
    )
    assert health.states == (
        AgentSpan("central", "cut off", 20, 20, "from the recorder", back_in=40),
    )
    assert health.messages_lost > 0
    assert "central: cut off from the recorder in cycles 20 to 39 (12:00:20 to 12:00:39)" in text


@pytest.mark.parametrize(
    ("cut", "ends"),
    [
        *(("central", "source listener"), ("central", "listener"), ("c1", "source listener")),
        *(("c1", "listener"), ("c1/inv01", "listener"), ("c1/inv01", "source")),
    ],
)
def test_an_agent_whose_link_is_cut_is_named_and_nobody_else(
    plant: str, tmp_path: Path, cut: str, ends: str
) -> None:
    faults = [f"{end}={cut},blackout=20s..50s" for end in ends.split()]
    options = RunOptions(duration="60", faults=faults, pace=1.0)
    prepared = prepare(load_scenario(plant), options, "cut")
    _, sent = run_in_memory(prepared.plan, prepared.profile)
    write_messages(tmp_path / "run.mcap", sent.messages, plan=prepared.plan)
    (span,) = health_of(tmp_path)[0].states
    assert span == AgentSpan(cut, "cut off", 20, 30, back_in=50)
    with RunReader(tmp_path) as run:
        states = states_of(run)
    ill = {agent for agent in states.agents if states.at(agent, 35).level}
    assert ill == {cut}


@pytest.mark.parametrize("run_id", [PLAN.run_id, "another-run"])
def test_the_launchers_account_is_read_beside_the_recording(tmp_path: Path, run_id: str) -> None:
    document = replace(
        summary_of(tmp_path),
        run_id=run_id,
        dropped={"late": 3},
        restarts={"recorder": 2},
        wrong=(WrongMessages("c1/a/impp", "out_of_range", 5, "x"),),
    )
    (tmp_path / SUMMARY_NAME).write_bytes(document.as_json())
    _, text = written(tmp_path)
    (tmp_path / FAILURE_NAME).write_text("c1/a ended\nwith status 1\n")
    assert "failed: c1/a ended with status 1" in health_of(tmp_path)[1]
    is_known = run_id == PLAN.run_id
    for part in ("late 3", "5 out_of_range on c1/a/impp", "states: recorder"):
        assert (part in text) == is_known
    assert ("summary.json is of another run" in text) == (not is_known)
    assert "there is no summary.json" not in text


def test_inputs_missed_at_deadlines_are_those_that_the_agents_counted(
    plant: str, tmp_path: Path
) -> None:
    options = RunOptions(duration="60", faults=["loss=5%"], pace=1.0)
    prepared = prepare(load_scenario(plant), options, "lossy")
    plan = with_changes(prepared.plan, cycle_wall_ns=prepared.plan.timing.cycle_ns)
    run, sent = run_in_memory(plan, prepared.profile)
    write_messages(tmp_path / "run.mcap", sent.messages, plan=plan)
    health, text = health_of(tmp_path)
    counted = sum(loop.inputs.missing for loop in run.loops.values())
    assert counted > 10
    assert sum(found.inputs for found in health.misses) == counted
    assert "fault: loss=0.05" in text
