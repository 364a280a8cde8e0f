"""What happens when a part of the team dies, freezes or is told to stop."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable

import pytest
from running import Heliarch, assert_none_left

from bus_schemas.signals import PRODUCTION
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


@pytest.fixture
def run(heliarch: Start) -> Heliarch:
    """A run that would go on for long, in its first cycles."""
    command = heliarch("launch", "oahu", "--duration", "5h")
    command.until_running()
    return command


def recorded_cycles(run: Heliarch) -> int:
    """Cycles in an ordered, indexed recording."""
    with RunReader(run.folder) as reader:
        return sum(1 for _ in reader.messages(PRODUCTION))


def test_a_killed_controller_ends_the_run_and_is_named(run: Heliarch) -> None:
    victim = run.process_of("c2/inv03")
    victim.send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert f"c2/inv03 (process {victim.pid}) was killed by signal 9" in run.error_text()
    assert "c2/inv03 is on the bus" in run.error_text(), "the last lines of its log"
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_a_frozen_controller_is_named_with_those_who_wait_for_it(run: Heliarch) -> None:
    run.process_of("c2/inv03").send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    assert "nothing more came from c2/inv03" in run.error_text()
    # Where in its cycle it froze decides whether its parent or the plant misses it first.
    assert re.search(r"(c2|plant) waits for c2/inv03/(impp|residual|command)", run.error_text())
    assert_none_left(run.folder)
    assert recorded_cycles(run) > 0


def test_a_killed_recorder_ends_the_run_and_is_named(run: Heliarch) -> None:
    run.process_of("recorder").send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert "recorder (process" in run.error_text()
    assert_none_left(run.folder)
    assert run.folder.joinpath("run.mcap").stat().st_size > 0


def test_a_frozen_recorder_ends_the_run_and_is_named(run: Heliarch) -> None:
    run.process_of("recorder").send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    assert "recorder has not been heard of" in run.error_text()
    assert_none_left(run.folder)


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


def test_sigterm_to_the_launcher_ends_everything(run: Heliarch) -> None:
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
