"""`heliarch report` makes a page of a recorded run, and tells what it cannot use in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import done, refusal
from recordings_by_hand import PLAN, cut, whole_run, write_messages, write_run

from recordings.read.run_file import RECORDING_NAME


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Folder of a run of 90 cycles."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(folder / RECORDING_NAME, whole_run(90))
    return folder


def test_the_report_is_in_the_folder_of_the_run(run: Path) -> None:
    assert done("report", run) == f"report: {run / 'report.html'}\n"
    page = (run / "report.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    for fact in (
        PLAN.run_id,
        "90 cycles of 1 s",
        "4 inverters",
        "Recorded by heliarch simulate",
        "Scenario: Four inverters.",
    ):
        assert fact in page


def test_recording_and_report_may_be_named_and_an_old_report_is_replaced(
    run: Path, tmp_path: Path
) -> None:
    path = tmp_path / "elsewhere.html"
    path.write_text("old")
    assert done("report", run / RECORDING_NAME, "--report", path) == f"report: {path}\n"
    assert path.stat().st_size > 1_000_000
    assert not (run / "report.html").exists()


def test_a_recording_that_was_cut_is_reported_as_far_as_it_goes(run: Path) -> None:
    cut(run / RECORDING_NAME)
    done("report", run)
    assert "recording is incomplete" in (run / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("scenario", "named"), [('title = "Four"', "complete cycle"), ("name = oahu", "TOML")]
)
def test_a_run_without_a_complete_cycle_or_a_scenario_is_refused(
    scenario: str, named: str, tmp_path: Path
) -> None:
    write_messages(tmp_path / RECORDING_NAME, [], scenario=scenario)
    assert named in refusal("report", tmp_path)
    assert not (tmp_path / "report.html").exists()
