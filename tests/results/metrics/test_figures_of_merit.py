"""The one list of figures of merit, the tables made from it, and its documentation."""

from __future__ import annotations

from pathlib import Path

import pytest
from runs_by_hand import run_of, sine_of_an_hour

from results.metrics import run_metrics
from results.metrics.figures_of_merit import (
    AGENTS,
    FIGURES_OF_MERIT,
    Shown,
    figures_json,
    runs_as_columns,
    shown_in,
)

WITH_REGULATION = run_metrics(sine_of_an_hour(response=0.75))
WITHOUT = run_metrics(run_of([100.0] * 4, 150.0, [100.0, 90.0, 20.0, 120.0], cycle_s=900.0))
FULL = run_metrics(run_of([100.0], 150.0, [100.0]))


def test_every_figure_is_found_in_a_run_that_defines_all() -> None:
    found = figures_json(WITH_REGULATION)
    missing = {name for name, value in found.items() if value is None}
    of_agents = {one.name for one in AGENTS}
    assert missing == {"ramp-limit", "above-ramp-limit", *of_agents}
    assert (found["precision"], found["capacity"]) == pytest.approx((0.75, 200.0))


def test_runs_stand_side_by_side() -> None:
    runs, figures = [("a", WITH_REGULATION), ("b", WITHOUT)], shown_in(Shown.REPORT)
    rows = {row[0]: row[1:] for row in runs_as_columns("Runs", runs, figures).texts()}
    assert rows["Mileage per hour"][0] == "kW/h"
    assert rows["Regulation capacity"] == ("kW", "200", "-")
    alone = runs_as_columns("Runs", runs[1:], figures)
    assert "Regulation capacity" not in {row[0] for row in alone.texts()}


def test_the_document_lists_every_figure_with_its_unit() -> None:
    document = Path(__file__).parents[3] / "docs" / "metrics.md"
    rows = [
        tuple(cell.strip(" `") for cell in line.strip("|").split("|")[:3])
        for line in document.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
    ]
    assert rows == [(one.name, one.title, one.unit) for one in FIGURES_OF_MERIT.values()]
