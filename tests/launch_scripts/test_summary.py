"""The table at the end of a run, and the same as JSON."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import heliarch
from msgspec.structs import replace
from reports_by_hand import summary_of

from agents.process.events import Complaint, Recorded
from bus_schemas.errors import InputError
from launch_scripts.run_end import begun, ended
from launch_scripts.run_folder import RunFolder
from results.figures import FIGURES
from results.run_document import (
    ExternalAccount,
    MessageCount,
    ProcessAccount,
    RunDocument,
    WrongMessages,
)
from results.summary_table import summary_table
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

SUMMARY = replace(
    summary_of(Path("runs/r")),
    planned_cycles=3600,
    cycle_s=1.0,
    offset_kw=80.0,
    cycles=3600,
    processes=(),
    messages=(),
)


def rows_of(summary: RunDocument) -> dict[str, list[str]]:
    return {name: cells for name, *cells in summary_table(summary).texts()}


BUSY = (
    ProcessAccount("recorder", "recorder", {}, 40.0, cpu_s=3.6),
    ProcessAccount("c1/a", "direct", {}, 40.0, 9.0, cpu_s=3.6),
    ProcessAccount("c1/b", "direct", {}, 40.0),
)
DEVICE = ExternalAccount("c1/inv01", {"impp": 5}, lost=100, expected=20, answered=5)
HALF = dict.fromkeys(FIGURES) | {
    **{"cycles": 35, "planned-cycles": 3600, "unknown-energy": 2.0},
    **{"shortfall": 0.0, "shortfall-energy": 0.0},
}


@pytest.mark.parametrize(
    ("changes", "row", "cells"),
    [
        ({}, "Figures of merit", ["-", "", "none"]),
        ({}, "Tracking RMSE", None),
        ({"figures": HALF}, "Figures of merit", ["-", "", "35 of 3,600 cycles"]),
        ({"figures": HALF}, "Shortfall", ["0.00", "kWh", "0.000 % of dispatch"]),
        ({"figures": HALF}, "Energy of lost inverters", ["2.0", "kWh", "not among"]),
        ({"processes": BUSY}, "Processor time per cycle", ["2.00", "ms"]),
        ({"processes": BUSY}, "Memory", ["9.0", "MB", "all processes"]),
        ({}, "Cycle rate", ["360.0"]),
        ({}, "Offset", ["80.0", "kW", "aimed above the dispatch"]),
        ({"cycles": 9}, "Cycles", ["9", "", "ended early, after 9 of 3,600 cycles"]),
        (
            {"cycles": 9, "interrupted": True},
            *("Cycles", ["9", "", "interrupted after 9 of 3,600 cycles"]),
        ),
        ({"external": (DEVICE,)}, "Missing in the recording", ["100"]),
        ({"external": (DEVICE,)}, "External c1/inv01", ["5", "", "100"]),
    ],
)
def test_a_row_tells_what_the_run_defines(
    changes: dict[str, Any], row: str, cells: list[str] | None
) -> None:
    rows = rows_of(replace(SUMMARY, **changes))
    assert (row in rows) == (cells is not None)
    assert all(part in cell for part, cell in zip(cells or (), rows.get(row, ()), strict=False))


def wrong(cause: str, count: int, publisher: str) -> WrongMessages:
    return WrongMessages(f"{publisher}/impp", cause, count, "it is odd", publisher)


@pytest.mark.parametrize(
    ("messages", "found", "failure"),
    [
        ((), (), None),
        ((), (wrong("conflicting", 1, "c2/d"),), "c2/d/impp"),
        ((MessageCount("impp", 11, 10),), (), "impp"),
        ((), (wrong("out_of_range", 3, "c1/inv01"),), "c1/inv01: 3 of 20 messages"),
        ((), (wrong("out_of_range", 2, "c1/inv01"),), None),
        ((), (wrong("duplicate", 9, "c1/inv01"),), None),
    ],
)
def test_an_unreliable_run_fails_in_one_line(
    messages: tuple[MessageCount, ...], found: tuple[WrongMessages, ...], failure: str | None
) -> None:
    summary = replace(SUMMARY, messages=messages, wrong=found, external=(DEVICE,))
    failures = [*summary.failures()]
    assert len(failures) == (failure is not None)
    assert all(failure and failure in line and "\n" not in line for line in failures)


def test_the_figures_of_merit_are_those_that_the_run_defines(plant: str, tmp_path: Path) -> None:
    words = ("simulate", plant, "--duration", "20", "--json", "-", "--out", tmp_path / "run")
    result = heliarch(*words)
    figures = json.loads(result.stdout)["figures"]
    rows = {line.split("  ")[0]: line for line in result.stderr.splitlines()}
    assert f"{figures['rmse']:,.2f}" in rows["Tracking RMSE"]
    assert "PJM performance score" not in rows


def test_wrong_messages_are_those_that_the_recorder_names(plant: str, tmp_path: Path) -> None:
    options = RunOptions(duration="5", external=["c1/inv01"])
    preparation = prepare(load_scenario(plant), options, "counted")
    dropped = [("c1/inv01/impp", "duplicate", 4), ("c1/inv02/impp", "late", 9)]
    complaint = Complaint("small/c1/inv01/impp", "duplicate", 5, "it came twice in cycle 3")
    recorded = Recorded({}, 0, 0, complaints=(complaint,))
    document = begun(preparation, RunFolder(tmp_path / "run"), "launch")
    found = ended(document, preparation, recorded, Counter(), dropped)
    assert [(wrong.key, wrong.cause, wrong.count) for wrong in found.wrong] == [
        ("c1/inv01/impp", "duplicate", 5)
    ]
    assert found.wrong[0].example == "it came twice in cycle 3"
    assert found.dropped == {"duplicate": 4, "late": 9}


def cut(recording: Path) -> None:
    os.truncate(recording, recording.stat().st_size // 2)


def empty(recording: Path) -> None:
    os.truncate(recording, 0)


@pytest.mark.parametrize("harm", [cut, empty, Path.unlink, None])
def test_a_recording_that_holds_less_than_was_recorded_is_a_failure(
    plant: str, tmp_path: Path, harm: Callable[[Path], None] | None
) -> None:
    folder = RunFolder(tmp_path / "run")
    heliarch("simulate", plant, "--duration", "300", "--out", folder.path)
    preparation = prepare(load_scenario(plant), RunOptions(duration="300"), "counted")
    counts = json.loads(folder.summary.read_bytes())["messages"]
    published = Counter({count["signal"]: count["published"] for count in counts})
    if harm is not None:
        harm(folder.recording)
    told = Recorded(dict(published), 0, 300)
    document = begun(preparation, folder, "launch")
    summary = ended(document, preparation, told, published, [])
    failures = [*summary.failures()]
    assert len(failures) == (harm is not None)
    covered = summary.figures["cycles"] if summary.figures else 0
    assert covered == 300 if harm is None else 0 <= (covered or 0) < 300
    assert harm is None or str(folder.recording) in failures[0]
    if harm is None:  # The recorder was cut off when the run ended.
        longer = replace(document, planned_cycles=310), preparation, replace(told, cycles=310)
        (failure,) = ended(*longer, published, []).failures()
        assert "300 to 309" in failure


def test_a_folder_that_cannot_be_made_is_named_with_its_option() -> None:
    with pytest.raises(InputError, match=r"^--out: .*got /proc/x"):
        RunFolder(Path("/proc/x")).make()
