"""The tables of a run fit into 100 columns, and name what was not kept."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import pytest
from msgspec.structs import replace
from reports_by_hand import HOST, floor_times, missed, reported, summary_of
from rich.console import Console
from timed_recordings import PLAN, cycle, recorded

from agents.events import ExternalAccount
from launch_scripts.launcher.wrong_messages import WrongMessages
from studies.timing.report import TimingReport, report_on
from studies.timing.table import print_report


def printed(found: TimingReport, *, processes: bool = False, width: int = 100) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    print_report(found, console, processes=processes)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def row(lines: list[str], name: str) -> list[str]:
    """The figures of the first row of this name."""
    found = re.findall(rf"^  {name} +(\d.*?) *$", "\n".join(lines), re.MULTILINE)
    return str(found[0]).split()


def test_each_row_has_its_figures_its_budget_and_its_verdict(tmp_path: Path) -> None:
    found = reported(tmp_path, budgets="hop_p99_ms = { residual = 0.45 }", floor=floor_times())
    lines = printed(found.report)
    count, *times_ms, limit_ms, verdict = row(lines, "residual")
    assert (count, limit_ms, verdict) == ("6", "0.450", "FAIL")
    assert [float(time) for time in times_ms] == pytest.approx([0.3, 0.4, 0.5, 0.5, 0.5], rel=0.01)
    assert row(lines, "central solve")[-2:] == ["15.000", "PASS"]
    assert row(lines, "timer")[:2] == ["2", "0.050"]
    assert any(line.startswith("  Zenoh round trip:") for line in lines)
    assert max(map(len, lines)) <= 100
    headings = [line.partition(" ")[0] for line in lines if "[ms]" in line]
    assert headings == ["loop", "decision", "hop", "lateness", "jitter", "age", "floor"]


@pytest.mark.parametrize("width", [80, 100, 200])
def test_no_figure_is_cut_in_a_narrow_terminal(width: int, tmp_path: Path) -> None:
    text = "\n".join(printed(reported(tmp_path, floor=floor_times()).report, width=width))
    assert "…" not in text
    assert "15.000" in text


def test_the_verdict_names_each_budget_that_was_not_kept(tmp_path: Path) -> None:
    assert printed(reported(tmp_path / "good").report)[-1].startswith("PASS")
    late = reported(tmp_path / "late", cycle(0), missed(1), lost=1).report
    lines = printed(late)
    not_kept = [line for line in lines if line.startswith("  not kept: ")]
    assert {line.split(": ")[1].rstrip("0123456789 ().atmos") for line in not_kept} >= {
        "missed deadline",
        "messages not recorded",
    }
    assert row(lines, "missed deadlines") == ["1", "0", "FAIL"]
    assert row(lines, "overruns") == ["0", "0", "PASS"]
    # processes, missed deadlines, missing and old inputs, dropped, overruns, skipped cycles
    assert row(lines, "plant")[:7] == ["1", "1", "1", "0", "0", "0", "0"]


def test_of_a_recording_alone_what_the_launcher_knew_is_missing_and_not_zero(
    tmp_path: Path,
) -> None:
    report = report_on(recorded(tmp_path, cycle(0), cycle(1))).report
    lines = printed(report)
    # dropped; processor time of all and of one, memory
    figures = row(lines, "direct")
    assert figures[4] == "-"
    assert figures[-3:] == ["-", "-", "-"]
    assert any("summary.json" in line for line in lines)
    document = json.loads(report.as_json())
    assert document["lost_messages"] is None
    assert document["tiers"][0]["cpu_percent"] is None
    assert document["processes"][0]["dropped"] is None


def test_the_summary_beside_a_recording_is_used_if_it_is_of_that_run(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    live = reported(folder, dropped=2).report
    assert live.tiers[0].cpu_percent == pytest.approx(10.0)
    summary = reported_summary(folder)
    later = report_on(folder).report
    assert later.tiers == live.tiers
    assert later.processes == live.processes
    (folder / "summary.json").write_bytes(summary.replace(b"by-hand-2", b"another"))
    assert report_on(folder / "run.mcap").report.tiers[0].cpu_percent is None


def reported_summary(folder: Path) -> bytes:
    """Write the summary of a run into its folder; return it."""
    document = summary_of(folder, dropped=2).as_json()
    (folder / "summary.json").write_bytes(document)
    return document


def test_locked_memory_and_a_busy_machine_are_told(tmp_path: Path) -> None:
    report = reported(tmp_path).report
    assert not any("locked" in line or "busy" in line for line in printed(report))
    host = replace(HOST, memory_locked=True, load_before=2.5)
    text = "\n".join(printed(replace(report, host=host)))
    assert "memory locked" in text
    assert "busy before the run" in text


def test_each_process_is_shown_if_asked_for(tmp_path: Path) -> None:
    report = reported(tmp_path, cycle(0), missed(1), by_agent=True).report
    assert not any(line.startswith("c2/d (direct)") for line in printed(report))
    lines = printed(report, processes=True)
    (heading,) = [line for line in lines if line.startswith("plant (plant)")]
    assert "missed apply 1" in heading
    assert row(lines, "hop c1/a/telemetry")[0] == "2"
    assert max(map(len, lines)) <= 100


def test_a_foreign_device_and_its_wrong_answers_are_told(tmp_path: Path) -> None:
    device = ExternalAccount("c2/d", {"command": 2}, lost=1, expected=6, answered=5)
    wrong = WrongMessages("c2/d/command", "not msgpack", 3, "b'x'")
    report = reported(tmp_path, plan=replace(PLAN, external=("c2/d",))).report
    found = replace(report, external=(device,), wrong=(wrong,), faults={"lost": 4})
    text = "\n".join(printed(found))
    assert "external c2/d: answered 5 times of 6" in text
    assert "wrong c2/d/command, 3 times: not msgpack: b'x'" in text
    assert "4 lost" in text
    assert row(text.splitlines(), "c2/d estimate")[0] == "2"
    assert "seen from outside" in text


def test_the_document_has_all_rows_and_histograms(tmp_path: Path) -> None:
    document = json.loads(reported(tmp_path, floor=floor_times()).report.as_json())
    assert (document["passed"], document["clean"]) == (True, True)
    setpoint = next(entry for entry in document["times"] if entry["of"] == "setpoint")
    assert setpoint["times"]["count"] == 12
    assert setpoint["times"]["histogram"]
    assert {entry["line"] for entry in document["verdicts"]} >= {
        "hop setpoint p99",
        "messages not recorded",
    }
    assert [process["agent"] for process in document["processes"]][:2] == ["plant", "central"]
    assert document["floor"][0]["times"]["min_us"] == 50.0
    assert document["slowest_cycles"][0]["slowest_agent"] == "c2/c"
