"""The whole plant as real processes over real Zenoh, each with one agent or with several."""

from __future__ import annotations

import signal
from pathlib import Path

import command_line
import msgspec
import pytest
from command_line import Result
from memory_runs import timeless
from running import Start, assert_none_left, small_plant

from agents.plan_file import load_plan
from bus_schemas.messages import Dispatch, Message
from bus_schemas.signals import SIGNALS
from recordings.read.reader import RunReader
from results.run_document import RunDocument

pytestmark = pytest.mark.processes

PATIENCE_S = 120.0
DECIDED = tuple(signal for signal in SIGNALS if signal.decided)


def decisions(folder: Path) -> dict[tuple[str, int], Message]:
    """All that the agents of a run decided, without times; of repeated messages the first."""
    found: dict[tuple[str, int], Message] = {}
    with RunReader(folder) as reader:
        for port, message in reader.messages(*DECIDED):
            found.setdefault((str(port), message.cycle), timeless(message))
    return found


def decided(folder: Path, command: str, *words: str) -> dict[tuple[str, int], Message]:
    """Launch or simulate a run from this process; return all that its agents decided."""
    command_line.heliarch(command, *words, "--out", folder)
    return decisions(folder)


def summary_of(folder: Path) -> RunDocument:
    """Return the summary that a run wrote, with what is in it checked."""
    return msgspec.json.decode((folder / "summary.json").read_bytes(), type=RunDocument)


CYCLES = 40

ORDERS = """
[[orders]]
at = 2
power_kw = 300
ramp_kw_per_min = 9000
hold_s = 20

[[orders]]
at = 30
power_kw = 1500
"""

GRID = """
[grid]
ramp_up_kw_per_min = 3000
ramp_down_kw_per_min = 3000
loss_constant_percent = 0.5
loss_quadratic_percent = 2

[grid.droop]
reserve_percent = 5

[frequency]
kind = "events"
events = [{ at = 8, depth_hz = -0.3, duration_s = 8 }, { at = 22, depth_hz = 0.2, duration_s = 5 }]
"""


STORAGE = """
[[storage]]
name = "battery"
rating_kw = 100
capacity_kwh = 2
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Tiers of which the upper ones act rarely, need, orders, a grid that asks, a storage."""
    tiers = "cluster_sizes = [[1, 1, 2], [2, 1]]\nperiod_cycles = [6, 3, 1]"
    changes = (
        ("cluster_sizes = [[2, 2]]", tiers),
        ("share = 0.5", "share = 1.1"),
        ('history = "hindsight"', f'history = "hindsight"\n{ORDERS}{GRID}{STORAGE}'),
    )
    return small_plant(tmp_path_factory.mktemp("plant"), *changes)


@pytest.fixture(scope="module")
def launched(plant: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """Folder and result of a plant of processes that has ended."""
    folder = tmp_path_factory.mktemp("launched") / "run"
    words = ("--duration", str(CYCLES), "--json", "-", "--out", folder)
    result = command_line.heliarch("launch", plant, *words)
    assert result.exit_code == 0, result.output
    return folder, result


@pytest.fixture(scope="module")
def ours(plant: str, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Message]:
    """What the same agents decide in one process."""
    folder = tmp_path_factory.mktemp("simulated") / "run"
    return decided(folder, "simulate", plant, "--duration", str(CYCLES))


def test_processes_decide_bit_for_bit_what_one_process_decides_and_all_is_recorded(
    launched: tuple[Path, Result], ours: dict[tuple[str, int], Message]
) -> None:
    folder, result = launched
    assert decisions(folder) == ours
    dispatch = [ours["dispatch", cycle] for cycle in (19, 30)]
    ordered_kw = [one.power_kw for one in dispatch if isinstance(one, Dispatch)]
    assert ordered_kw == [300.0, 1500.0]
    assert_none_left(folder)
    summary = summary_of(folder)
    assert msgspec.json.decode(result.stdout)["cycles"] == CYCLES, "--json - has it for itself"
    with RunReader(folder) as reader:
        recorded = [port.signal.name for port, _ in reader.messages()]
    counts = {count.signal: count.recorded for count in summary.messages}
    assert counts["telemetry"] == counts["command"] == CYCLES * 5
    assert {name: recorded.count(name) for name in counts} == counts
    assert (summary.lost, summary.dropped) == (0, {})


def test_a_run_that_sigterm_ends_completes_its_cycle_and_its_files(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "1h", "--pace", "10")
    run.until_recorded(5)
    assert run.interrupt(signal.SIGTERM) == 130, run.error_text()
    summary = summary_of(run.folder)
    assert summary.interrupted
    assert summary.figures is not None
    assert summary.lost == 0


@pytest.mark.parametrize(("processes", "number"), [("cluster", 9), ('["z2"]', 10)])
def test_several_agents_in_one_process_decide_what_they_decide_alone(
    plant: str,
    tmp_path: Path,
    processes: str,
    number: int,
    ours: dict[tuple[str, int], Message],
) -> None:
    words = (plant, "--duration", str(CYCLES), "--set", f"processes={processes}")
    assert decided(tmp_path / "run", "launch", *words) == ours
    summary = summary_of(tmp_path / "run")
    assert len(load_plan(tmp_path / "run" / "plan.json").processes) == number
    assert len(summary.processes) == number
    assert (summary.lost, summary.dropped) == (0, {})


def test_so_do_they_by_the_clock_if_they_have_the_time(plant: str, tmp_path: Path) -> None:
    words = (plant, "--duration", "4")
    for pace in ("4", "1", "0.2"):  # One that this machine keeps up with.
        ours = decided(tmp_path / pace, "launch", *words, "--pace", pace)
        summary = summary_of(tmp_path / pace)
        if not (summary.missing_inputs or summary.skipped_cycles or summary.lost):
            break
    assert (summary.missing_inputs, summary.skipped_cycles, summary.lost) == (0, 0, 0)
    assert ours == decided(tmp_path / "simulated", "simulate", *words)
