"""What happens when a part of the team dies, freezes or is told to stop."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable

import pytest
from running import Heliarch, assert_none_left

from agents.plan import load_plan
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


def long_run(heliarch: Start, **patience: float) -> Heliarch:
    """A run that would go on for long, in its first cycles, of which some are on disk."""
    command = heliarch("launch", "oahu", "--duration", "5h", **patience)
    command.until(lambda: recorded_cycles(command) > 0, "cycles that can be read on disk")
    return command


@pytest.fixture
def run(heliarch: Start) -> Heliarch:
    return long_run(heliarch)


def recorded_cycles(run: Heliarch) -> int:
    """Cycles that can be read from the recording: none before its first flush."""
    try:
        with RunReader(run.folder) as reader:
            return sum(1 for _ in reader.messages(PRODUCTION))
    except InputError:
        return 0


def a_direct_controller(run: Heliarch) -> str:
    """Name of the first direct controller of cluster c2."""
    return load_plan(run.folder / "plan.json").tree.children("c2")[0]


def test_a_killed_controller_ends_the_run_and_is_named(run: Heliarch) -> None:
    name = a_direct_controller(run)
    victim = run.process_of(name)
    victim.send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert f"{name} (process {victim.pid}) was killed by signal 9" in run.error_text()
    assert f"{name} is on the bus" in run.error_text(), "the last lines of its log"
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_a_frozen_controller_is_named_with_those_who_wait_for_it(heliarch: Start) -> None:
    run = long_run(heliarch, stall_s=3.0)
    name = a_direct_controller(run)
    run.process_of(name).send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    # One who waits for it and is slow to say so is named beside it.
    blamed = re.search(r"nothing more came from (.*)", run.error_text())
    assert blamed is not None, run.error_text()
    assert name in blamed[1].split(", ")
    # Where in its cycle it froze decides whether its parent or the plant misses it first.
    assert re.search(rf"(c2|plant) waits for {name}/(impp|residual|command)", run.error_text())
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_a_killed_recorder_ends_the_run_and_is_named(run: Heliarch) -> None:
    run.process_of("recorder").send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert "recorder (process" in run.error_text()
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0, "what was flushed before the kill can be read"


def test_a_frozen_recorder_ends_the_run_and_is_named(heliarch: Start) -> None:
    run = long_run(heliarch, heartbeat_s=2.0)
    run.process_of("recorder").send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    assert "recorder has not been heard of" in run.error_text()
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_a_killed_plant_ends_the_run_and_is_named(run: Heliarch) -> None:
    run.process_of("plant").send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert "plant (process" in run.error_text()
    assert_none_left(run.folder)


def test_a_killed_launcher_leaves_no_process_and_a_readable_recording(run: Heliarch) -> None:
    run.process.send_signal(signal.SIGKILL)
    run.wait()
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


@pytest.mark.parametrize("processes", [1, 12])
def test_a_launcher_killed_while_it_starts_processes_leaves_none(
    heliarch: Start, processes: int
) -> None:
    run = heliarch("launch", "oahu", "--duration", "5h")
    run.until(lambda: len(run.processes()) >= processes, "its processes")
    run.process.send_signal(signal.SIGKILL)
    run.wait()
    assert_none_left(run.folder)


def test_ctrl_c_ends_a_simulation_with_its_table_and_130(heliarch: Start) -> None:
    run = heliarch("simulate", "oahu", "--duration", "10h")
    run.until(lambda: recorded_cycles(run) > 0, "cycles that can be read on disk")
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130, run.error_text()
    assert "satisfied commitment" in run.output.read_text()
    assert recorded_cycles(run) > 0


def test_each_agent_is_a_process_with_a_log_and_sigterm_to_the_launcher_ends_all(
    run: Heliarch,
) -> None:
    assert len({process.pid for process in run.processes()}) == 23
    assert len(list((run.folder / "logs").glob("*.log"))) == 23
    run.process.send_signal(signal.SIGTERM)
    assert run.wait() == 143
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_ctrl_c_completes_the_cycle_and_ends_with_130(run: Heliarch) -> None:
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130
    assert "satisfied commitment" in run.output.read_text()
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_ctrl_c_before_the_first_cycle_ends_everything(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "5h")
    run.until(lambda: len(run.processes()) > 5, "its processes")
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130
    assert_none_left(run.folder)
