"""The one list of figures of merit, the tables made from it, and its documentation."""

from __future__ import annotations

from pathlib import Path

import pytest
from runs_by_hand import run_of, sine_of_an_hour

from studies.metrics import run_metrics
from studies.metrics.figures_of_merit import (
    FIGURES_OF_MERIT,
    figures_json,
    runs_as_columns,
    shown_in,
)
from studies.tables import json_rows

WITH_REGULATION = run_metrics(sine_of_an_hour(response=0.75))
WITHOUT = run_metrics(run_of([100.0] * 4, 150.0, [100.0, 90.0, 20.0, 120.0], cycle_s=900.0))
FULL = run_metrics(run_of([100.0], 150.0, [100.0]))


def test_every_figure_is_found_in_a_run_that_defines_all() -> None:
    found = figures_json(WITH_REGULATION)
    assert {name for name, value in found.items() if value is None} == {
        "ramp-limit",
        "above-ramp-limit",
    }
    assert found["precision"] == pytest.approx(0.75)
    assert found["capacity"] == 200.0


def test_shares_are_of_the_desired_energy() -> None:
    found = figures_json(WITHOUT)
    assert found["shortfall-energy"] == pytest.approx(22.5)
    assert found["shortfall"] == pytest.approx(22.5)
    assert found["satisfied"] == pytest.approx(77.5)
    assert found["score"] is None


def test_runs_stand_side_by_side() -> None:
    runs = [("a", WITH_REGULATION), ("b", WITHOUT)]
    table = runs_as_columns("Runs", runs, shown_in("report"))
    rows = {row[0]: row[1:] for row in table.texts()}
    assert rows["Mileage per hour"][0] == "kW/h"
    assert rows["Regulation capacity"] == ("kW", "200", "-")
    alone = runs_as_columns("Runs", [("b", WITHOUT)], shown_in("report"))
    assert "Regulation capacity" not in {row[0] for row in alone.texts()}


def test_of_two_runs_the_last_column_is_the_second_less_the_first() -> None:
    figures = shown_in("compare")
    table = runs_as_columns("Runs", [("a", WITHOUT), ("b", FULL)], figures, difference=True)
    rows = {row["figure"]: row for row in json_rows(table)}
    assert rows["Satisfied commitment"]["difference"] == pytest.approx(22.5)
    assert rows["Mileage per hour"]["difference"] == pytest.approx(-160.0)  # 0, 10, 80, 0 in 1 h
    assert "PJM performance score" not in rows


def test_a_figure_that_one_run_lacks_has_no_difference() -> None:
    runs = [("a", WITHOUT), ("b", WITH_REGULATION)]
    table = runs_as_columns("Runs", runs, shown_in("compare"), difference=True)
    rows = {row["figure"]: row for row in json_rows(table)}
    assert rows["Precision"]["b"] == pytest.approx(0.75)
    assert rows["Precision"]["difference"] is None


def test_the_document_lists_every_figure_with_its_unit() -> None:
    document = Path(__file__).parents[3] / "docs" / "metrics.md"
    rows = [
        [cell.strip(" `") for cell in line.strip("|").split("|")]
        for line in document.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
    ]
    listed = {row[0]: (row[1], row[2]) for row in rows}
    assert listed == {
        figure.name: (figure.title, figure.unit) for figure in FIGURES_OF_MERIT.values()
    }
