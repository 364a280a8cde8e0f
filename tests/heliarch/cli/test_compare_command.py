"""`heliarch compare`: its tables, its JSON, its page, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from command_line import done
from running import small_plant


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_plant(tmp_path_factory.mktemp("compare"))


def test_one_case_is_a_table_and_a_page_with_each_scheme_and_actuator(
    small: str, tmp_path: Path
) -> None:
    page, document = tmp_path / "compare.html", tmp_path / "rows.json"
    words = ("--actuator", "limit,fraction", "--report", page, "--json", document)
    text = done("compare", small, "--duration", "60", "--schemes", "paper,uncontrolled", *words)
    rows = [line.split()[:2] for line in text.splitlines()]
    expected = [["paper", "limit"], ["paper", "fraction"], ["uncontrolled", "-"]]
    assert all(row in rows for row in expected)
    assert 'id="frontier-plot"' in page.read_text(encoding="utf-8")
    found = [(row["scheme"], row["actuator"]) for row in json.loads(document.read_bytes())]
    assert found == [("paper", "limit"), ("paper", "fraction"), ("uncontrolled", None)]


def test_one_case_shows_regulation_and_what_faults_did() -> None:
    words = "oahu-day --from 10:00 --duration 60 --fault loss=50% --schemes paper"
    text = done("compare", *words.split())
    assert all(title in text for title in ("Regulation signal", "Help, missed inputs and reverts"))


def test_many_cases_have_a_row_each_and_a_summary_as_csv(small: str, tmp_path: Path) -> None:
    summary, document = tmp_path / "summary.csv", tmp_path / "rows.json"
    schemes = ("--schemes", "paper,uniform-cap")
    words = ("--set", "commitment.share=0.3,0.5", "--seeds", "1,2", "--show", "rmse", *schemes)
    text = done("compare", small, "--duration", "60", *words, "--json", document, "--csv", summary)
    assert all(f"share={share}" in text for share in ("0.3", "0.5"))
    cases = json.loads(document.read_bytes())
    assert [(row["case"], row["scheme"]) for row in cases] == [
        (f"share={share} seed={seed}", scheme)
        for share in ("0.3", "0.5")
        for seed in (1, 2)
        for scheme in ("paper", "uniform-cap")
    ]
    rmse = [row["rmse"] for row in cases if row["scheme"] == "paper"]
    rows = csv.DictReader(summary.open(encoding="utf-8"))
    means = [row for row in rows if (row["figure"], row["scheme"]) == ("rmse", "paper")]
    assert [row["cases"] for row in means] == ["2", "2"]
    assert all("hindsight" in row["remarks"] for row in means)
    assert float(means[0]["mean"]) == pytest.approx(sum(rmse[:2]) / 2.0)
