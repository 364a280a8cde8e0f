"""`heliarch compare` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from launch_scripts.cli import app

RUNNER = CliRunner()


def compare(*words: str) -> tuple[int, str, str]:
    found = RUNNER.invoke(app, ["compare", *words])
    return found.exit_code, found.stdout, found.stderr


def test_one_case_gives_the_papers_table_a_row_a_scheme() -> None:
    status, text, _ = compare("oahu", "--duration", "60", "--schemes", "paper,predictive")
    assert status == 0
    assert "60 cycles of 1 s, actuator fraction" in text
    assert [line.split()[1] for line in text.splitlines() if line.startswith("│")] == [
        "paper",
        "predictive",
    ]


def test_a_reference_group_can_be_named() -> None:
    status, text, _ = compare(
        "oahu", "--duration", "60", "--schemes", "grouping", "--reference", "inv01,inv07"
    )
    assert status == 0
    assert [line.split()[1] for line in text.splitlines() if line.startswith("│")] == ["grouping"]


def test_a_regulation_signal_gives_the_second_table() -> None:
    status, text, _ = compare(
        "oahu-day", "--from", "10:00", "--duration", "10m", "--schemes", "paper"
    )
    assert status == 0
    assert "Regulation signal" in text


def test_many_cases_give_one_figure_a_row_a_case(tmp_path: Path) -> None:
    out = tmp_path / "rows.json"
    status, text, _ = compare(
        "oahu",
        "--duration",
        "60",
        "--set",
        "commitment.share=0.3,0.5",
        "--schemes",
        "paper,uniform-cap",
        "--show",
        "rmse",
        "--json",
        str(out),
    )
    assert status == 0
    assert "rmse, kW" in text
    rows = json.loads(out.read_text())
    assert [(row["case"], row["scheme"]) for row in rows] == [
        ("share=0.3", "paper"),
        ("share=0.3", "uniform-cap"),
        ("share=0.5", "paper"),
        ("share=0.5", "uniform-cap"),
    ]
    assert all(row["control-caused"] >= 0.0 for row in rows)


def test_json_on_standard_output_is_all_that_is_there() -> None:
    status, text, _ = compare("oahu", "--duration", "20", "--schemes", "paper", "--json", "-")
    assert status == 0
    assert json.loads(text)[0]["scheme"] == "paper"


def test_json_and_report_follow_a_link_and_leave_it_one(tmp_path: Path) -> None:
    rows, page = tmp_path / "kept.json", tmp_path / "kept.html"
    (tmp_path / "link.json").symlink_to(rows)
    (tmp_path / "link.html").symlink_to(page)
    links = ("--json", str(tmp_path / "link.json"), "--report", str(tmp_path / "link.html"))
    status, _, _ = compare("oahu", "--duration", "20", "--schemes", "paper", *links)
    assert status == 0
    assert json.loads(rows.read_text())[0]["scheme"] == "paper"
    assert "<html" in page.read_text()
    assert all((tmp_path / name).is_symlink() for name in ("link.json", "link.html"))


def test_a_report_holds_all_schemes(tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    status, text, _ = compare(
        "oahu", "--duration", "120", "--schemes", "paper,uniform-cap", "--report", str(out)
    )
    assert status == 0
    assert str(out) in text.replace("\n", "")
    page = out.read_text()
    assert "uniform-cap" in page
    assert "paper" in page
