"""`heliarch report` makes a page of a recorded run, and tells what it cannot use in one line."""

from __future__ import annotations

import html
import shutil
import tomllib
from pathlib import Path

import pytest
from command_line import done, heliarch, refusal
from recordings_by_hand import cut, write_messages

from agents.plan import load_plan
from recordings.read.run_file import RECORDING_NAME


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 90 cycles."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    done("simulate", "oahu", "--duration", "90s", "--out", folder)
    return folder


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def test_the_report_is_in_the_folder_of_the_run(run: Path) -> None:
    assert done("report", run) == f"report: {run / 'report.html'}\n"
    page = (run / "report.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert load_plan(run / "plan.json").run_id in page
    assert "90 cycles of 1 s" in page
    assert "17 inverters" in page
    assert "Recorded by heliarch simulate" in page
    scenario = tomllib.loads((run / "scenario.toml").read_text(encoding="utf-8"))
    assert html.escape(f"Scenario: {scenario['title']}.") in page


def test_recording_and_report_may_be_named_and_an_old_report_is_replaced(
    run: Path, tmp_path: Path
) -> None:
    path = tmp_path / "elsewhere.html"
    path.write_text("old")
    result = heliarch("report", run / RECORDING_NAME, "--report", path)
    assert result.stdout == f"report: {path}\n"
    assert path.stat().st_size > 1_000_000
    assert not (run / "report.html").exists()


def test_a_recording_that_was_cut_is_reported_as_far_as_it_goes(run: Path) -> None:
    cut(run / RECORDING_NAME)
    done("report", run)
    assert "recording is incomplete" in (run / "report.html").read_text(encoding="utf-8")


def test_a_run_without_a_complete_cycle_is_refused(run: Path) -> None:
    recording = run / RECORDING_NAME
    recording.unlink()
    write_messages(recording, [], plan=load_plan(run / "plan.json"))
    assert "complete cycle" in refusal("report", run)
    recording.unlink()
    write_messages(recording, [], plan=load_plan(run / "plan.json"), scenario="name = oahu")
    assert "TOML" in refusal("report", run)
    assert not (run / "report.html").exists()
