"""What processes said over Zenoh, agents in memory say again, also where deadlines were missed."""

from __future__ import annotations

import signal
from collections.abc import Callable
from itertools import pairwise

import pytest
from running import Heliarch
from verifying import assert_equal_as_far_as_recorded, findings, verified

from agents.plan import load_plan
from bus_schemas.errors import InputError
from bus_schemas.signals import IMPP, PRODUCTION
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


def recorded_cycles(run: Heliarch) -> int:
    """Cycles that can be read from the recording: none before its first flush."""
    try:
        with RunReader(run.folder) as reader:
            return sum(1 for _ in reader.messages(PRODUCTION))
    except InputError:
        return 0


def most_skipped(run: Heliarch, agent: str) -> int:
    """Cycles that an agent skipped in its longest pause: nothing of it is recorded."""
    with RunReader(run.folder) as reader:
        cycles = [m.cycle for _, m in reader.messages(IMPP) if m.source == agent]
    return max(later - cycle - 1 for cycle, later in pairwise(cycles))


def grows(run: Heliarch) -> Callable[[], bool]:
    """Return whether more of the run is on disk than now."""
    before = recorded_cycles(run)
    return lambda: recorded_cycles(run) > before


def test_a_run_in_real_time_with_a_supervisor_that_stood_still_verifies_equal(
    heliarch: Start,
) -> None:
    run = heliarch("launch", "oahu", "--pace", "20", "--duration", "1h")
    run.until(lambda: recorded_cycles(run) > 0, "cycles that can be read on disk")
    process = run.process_of("c2")
    process.send_signal(signal.SIGSTOP)
    # What is on disk lags behind: only what comes with the next flush but one is after the stop.
    for _ in range(2):
        run.until(grows(run), "a flush")
    stopped_at = recorded_cycles(run)
    run.until(lambda: recorded_cycles(run) > stopped_at + 15, "cycles without it")
    process.send_signal(signal.SIGCONT)
    run.until(lambda: most_skipped(run, "c2") > 10, "what it says after it has skipped cycles")
    run.process.send_signal(signal.SIGINT)
    run.wait()
    found = verified(run)
    assert found.total("missing_inputs") > 0
    assert found.total("compared") > 0
    assert_equal_as_far_as_recorded(run, found)


def test_a_run_that_a_killed_controller_ended_verifies_equal_up_to_there(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "5h")
    run.until(lambda: recorded_cycles(run) > 40, "cycles that can be read on disk")
    tree = load_plan(run.folder / "plan.json").tree
    run.process_of(tree.children("c2")[0]).send_signal(signal.SIGKILL)
    assert run.wait() == 1
    found = verified(run)
    assert findings(found) == {}
    assert found.stop_cycle is None
    assert found.total("compared") > 0.8 * found.recorded
