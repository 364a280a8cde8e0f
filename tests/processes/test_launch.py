"""The whole plant as real processes over real Zenoh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from running import Heliarch, assert_none_left

from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, HELP, IMPP, RESIDUAL, SETPOINT
from launch_scripts.summary import RunSummary
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


def decisions(folder: Path) -> dict[tuple[str, int], Message]:
    """All that the controllers of a run decided, without the time at which it went out.

    Of what a device says several times in a cycle, the first.
    """
    found: dict[tuple[str, int], Message] = {}
    signals = (IMPP, RESIDUAL, HELP, SETPOINT, COMMAND)
    with RunReader(folder) as reader:
        for port, message in reader.messages(*signals, by_time=False):
            timeless = msgspec.structs.replace(message, publish_time_ns=0)
            found.setdefault((str(port), message.cycle), timeless)
    return found


def summary_of(folder: Path) -> RunSummary:
    """Return the summary that a run wrote, with what is in it checked."""
    document = msgspec.json.decode((folder / "summary.json").read_bytes())
    return msgspec.convert(document, RunSummary)


@pytest.mark.parametrize(("scenario", "cycles", "agents"), [("oahu", 120, 21), ("valley", 20, 76)])
def test_processes_decide_bit_for_bit_what_one_process_decides(
    heliarch: Start, scenario: str, cycles: int, agents: int
) -> None:
    words = (scenario, "--duration", str(cycles), "--seed", "3")
    launched, simulated = heliarch("launch", *words), heliarch("simulate", *words)
    assert (launched.wait(), simulated.wait()) == (0, 0), launched.error_text()
    ours, theirs = decisions(launched.folder), decisions(simulated.folder)
    assert len(ours) > cycles * agents * 2
    assert ours == theirs
    assert_none_left(launched.folder)


def test_every_message_that_was_published_is_in_the_recording(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "60")
    assert run.wait() == 0, run.error_text()
    summary = summary_of(run.folder)
    with RunReader(run.folder) as reader:
        recorded = [port.signal.name for port, _ in reader.messages()]
    counts = {count.signal: count.recorded for count in summary.messages}
    assert counts["telemetry"] == 60 * 17
    assert counts["impp"] == 60 * 21
    assert {name: recorded.count(name) for name in counts} == counts
    assert summary.lost == 0
    assert summary.dropped == {}


def test_each_agent_is_a_process_with_a_log_of_its_own(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "1h")
    run.until_running()
    processes = run.processes()
    assert len({process.pid for process in processes}) == 23
    assert len(list((run.folder / "logs").glob("*.log"))) == 23


def test_two_plants_run_side_by_side(heliarch: Start) -> None:
    one = heliarch("launch", "oahu", "--duration", "60", "--seed", "1")
    other = heliarch("launch", "oahu", "--duration", "60", "--seed", "2")
    assert (one.wait(), other.wait()) == (0, 0), one.error_text() + other.error_text()
    for run in (one, other):
        summary = summary_of(run.folder)
        assert (summary.cycles, summary.lost, summary.dropped) == (60, 0, {})
    assert decisions(one.folder) != decisions(other.folder)


def test_in_real_time_the_plant_ticks_through_all_cycles_and_says_what_was_missing(
    heliarch: Start,
) -> None:
    run = heliarch("launch", "oahu", "--duration", "40", "--pace", "20")
    run.wait()  # On a slow machine messages may get lost: then the run fails, and says so.
    summary = summary_of(run.folder)
    assert summary.cycles == 40
    with RunReader(run.folder) as reader:
        silent_cycles = {m.cycle for _, m in reader.messages(IMPP) if m.missing}
    assert bool(silent_cycles) <= (summary.missing_inputs > 0)
    assert_none_left(run.folder)


def test_the_summary_goes_to_standard_output_alone_if_asked_for(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "5", "--json", "-")
    assert run.wait() == 0
    document = msgspec.json.decode(run.output.read_bytes())
    assert document["cycles"] == 5
    assert document["messages_lost"] == 0
    assert "armed" in run.error_text()
