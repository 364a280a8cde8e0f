"""The whole plant as real processes over real Zenoh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from running import Heliarch, assert_none_left, small_plant
from typer.testing import CliRunner

from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS
from launch_scripts.cli import app
from launch_scripts.launcher.summary import RunSummary
from recordings.read.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]

DECIDED = tuple(signal for signal in SIGNALS if signal.decided)


def decisions(folder: Path) -> dict[tuple[str, int], Message]:
    """All that the agents of a run decided, without the times at which they did.

    Of what a device sends several times in a cycle, the first.
    """
    found: dict[tuple[str, int], Message] = {}
    with RunReader(folder) as reader:
        for port, message in reader.messages(*DECIDED):
            timeless = msgspec.structs.replace(message, publish_time_ns=0, ready_time_ns=0)
            found.setdefault((str(port), message.cycle), timeless)
    return found


def simulated(folder: Path, *words: str) -> dict[tuple[str, int], Message]:
    """All that the same agents decide in one process: in this one."""
    result = CliRunner().invoke(app, ["simulate", *words, "--out", str(folder)])
    assert result.exit_code == 0, result.output
    return decisions(folder)


def summary_of(folder: Path) -> RunSummary:
    """Return the summary that a run wrote, with what is in it checked."""
    document = msgspec.json.decode((folder / "summary.json").read_bytes())
    return msgspec.convert(document, RunSummary)


CYCLES = 40


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_plant(tmp_path_factory.mktemp("plant"))


@pytest.fixture(scope="module")
def launched(plant: str, lasting_heliarch: Start) -> Heliarch:
    """A plant of processes that has ended."""
    run = lasting_heliarch("launch", plant, "--duration", str(CYCLES), "--json", "-")
    assert run.wait() == 0, run.error_text()
    return run


def test_processes_decide_bit_for_bit_what_one_process_decides(
    launched: Heliarch, plant: str, tmp_path: Path
) -> None:
    ours = decisions(launched.folder)
    assert len(ours) > CYCLES * (3 + 4 + 2 * 7 + 6 + 4)
    assert ours == simulated(tmp_path / "simulated", plant, "--duration", str(CYCLES))
    assert_none_left(launched.folder)


def test_so_do_they_by_the_clock(plant: str, heliarch: Start, tmp_path: Path) -> None:
    words = (plant, "--duration", "4", "--pace", "0.5")
    launched = heliarch("launch", *words)
    assert launched.wait() == 0, launched.error_text()
    summary = summary_of(launched.folder)
    assert (summary.missing_inputs, summary.skipped_cycles, summary.lost) == (0, 0, 0)
    ours = simulated(tmp_path / "simulated", plant, "--duration", "4")
    assert decisions(launched.folder) == ours


def test_so_does_a_deeper_plant_whose_tiers_act_more_and_more_rarely(
    tmp_path: Path, heliarch: Start
) -> None:
    deep = (
        "cluster_sizes = [[2, 2]]",
        "cluster_sizes = [[1, 1, 2], [2, 1]]\nperiod_cycles = [6, 3, 1]",
    )
    words = (small_plant(tmp_path / "deep", deep), "--duration", "20")
    launched = heliarch("launch", *words)
    assert launched.wait() == 0, launched.error_text()
    assert decisions(launched.folder) == simulated(tmp_path / "simulated", *words)


def test_every_message_that_was_published_is_in_the_recording(launched: Heliarch) -> None:
    summary = summary_of(launched.folder)
    with RunReader(launched.folder) as reader:
        recorded = [port.signal.name for port, _ in reader.messages()]
    counts = {count.signal: count.recorded for count in summary.messages}
    assert counts["telemetry"] == counts["command"] == CYCLES * 4
    assert counts["impp"] == counts["residual"] == CYCLES * 7
    assert {name: recorded.count(name) for name in counts} == counts
    assert (summary.lost, summary.dropped) == (0, {})


def test_the_summary_goes_to_standard_output_alone_if_asked_for(launched: Heliarch) -> None:
    document = msgspec.json.decode(launched.output.read_bytes())
    assert document["cycles"] == CYCLES
    assert document["messages_lost"] == 0
    assert "armed" in launched.error_text()


def test_two_plants_side_by_side_do_not_hear_each_other(plant: str, heliarch: Start) -> None:
    runs = [heliarch("launch", plant, "--duration", str(CYCLES), "--seed", seed) for seed in "23"]
    assert [run.wait() for run in runs] == [0, 0]
    for run in runs:
        summary = summary_of(run.folder)
        assert (summary.cycles, summary.lost, summary.dropped) == (CYCLES, 0, {})
    assert decisions(runs[0].folder) != decisions(runs[1].folder)


def test_the_default_plant_runs_as_23_processes_of_99_messages_a_cycle_and_help(
    heliarch: Start,
) -> None:
    run = heliarch("launch", "oahu", "--duration", "10")
    assert run.wait() == 0, run.error_text()
    summary = summary_of(run.folder)
    assert len(summary.processes) == 23
    counts = {count.signal: count.recorded for count in summary.messages}
    for other in ("help", "run", "notice"):
        counts.pop(other, None)
    # Telemetry and command of 17, dispatch, meter, production; impp and residual of 21; setpoint
    # of 20.
    assert sum(counts.values()) == 10 * (2 * 17 + 3 + 2 * 21 + 20) == 10 * 99
