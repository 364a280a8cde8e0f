"""The table at the end of a run, and the same as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import heliarch
from msgspec.structs import replace
from reports_by_hand import summary_of

from agents.process.events import Complaint, ExternalAccount, Recorded
from launch_scripts.account import RunAccount
from launch_scripts.run_folder import RunFolder
from results.run_summary import MessageCount, ProcessAccount, RunSummary
from results.summary_table import summary_table
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

SUMMARY = replace(summary_of(Path("runs/r")), cycles=3600, cycle_s=1.0, processes=())


def rows_of(summary: RunSummary) -> dict[str, list[str]]:
    return {name: cells for name, *cells in summary_table(summary).texts()}


BUSY = (
    ProcessAccount("recorder", "recorder", {}, 40.0, cpu_s=3.6),
    ProcessAccount("c1/a", "direct", {}, 40.0, cpu_s=3.6),
    ProcessAccount("c1/b", "direct", {}, 40.0),
)
DEVICE = ExternalAccount("c1/inv01", {"impp": 5}, lost=100, expected=20, answered=5)
SEEN = MessageCount("production", 3600, 3589)


@pytest.mark.parametrize(
    ("changes", "row", "cells"),
    [
        ({}, "Figures of merit", ["-"]),
        ({}, "Tracking RMSE", None),
        ({"processes": BUSY}, "Processor time per cycle", ["2.00", "ms"]),
        ({"missing_inputs": 13}, "Inputs missed at deadlines", ["13"]),
        ({"messages": (SEEN,)}, "Cycles", ["3,600", "", "3,589 of them recorded"]),
        ({"messages": (SEEN,)}, "Cycle rate", ["360.0"]),
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


def test_the_figures_of_merit_are_those_that_the_run_defines(plant: str, tmp_path: Path) -> None:
    words = ("simulate", plant, "--duration", "20", "--json", "-", "--out", tmp_path / "run")
    result = heliarch(*words)
    figures = json.loads(result.stdout)["figures"]
    rows = {line.split("  ")[0]: line for line in result.stderr.splitlines()}
    assert f"{figures['rmse']:,.2f}" in rows["Tracking RMSE"]
    assert "PJM performance score" not in rows


def test_of_recorder_and_listeners_the_larger_count_holds_and_processes_may_be_late(
    plant: str, tmp_path: Path
) -> None:
    options = RunOptions(duration="5", external=["c1/inv01"])
    preparation = prepare(load_scenario(plant), options, "counted")
    account = RunAccount(preparation, RunFolder(tmp_path / "run"), "launch", 0.0)
    account.dropped += [
        ("c1/inv01/impp", "duplicate", 4),
        ("c1/inv01/impp", "late", 2),
        ("c1/inv02/impp", "late", 9),
        ("c1/inv01/impp", "late", 1),
    ]
    complaint = Complaint("small/c1/inv01/impp", "duplicate", 5, "it came twice in cycle 3")
    found = account.summary(Recorded({}, 0, 0, complaints=(complaint,)), 1.0, interrupted=False)
    assert [(wrong.key, wrong.cause, wrong.count) for wrong in found.wrong] == [
        ("c1/inv01/impp", "duplicate", 5),
        ("c1/inv01/impp", "late", 3),
    ]
    assert found.wrong[0].example == "it came twice in cycle 3"
    assert found.dropped == {"duplicate": 4, "late": 12}
