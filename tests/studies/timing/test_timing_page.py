"""The page of a run has its tables, percentile curves and who waited for whom."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from reports_by_hand import floor_times, reported

from studies.timing.page import run_page, sweep_page
from studies.timing.sweep import RateRow, Sweep


def plot(page: str, anchor: str) -> dict[str, Any]:
    """Data and layout of a figure, as they stand in the page."""
    found = re.search(rf'id="{anchor}-plot-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None, anchor
    document: dict[str, Any] = json.loads(found[1])
    return document


@pytest.fixture
def page(tmp_path: Path) -> str:
    return run_page(reported(tmp_path, floor=floor_times()))


def test_the_page_says_what_was_run_on_what_and_the_verdict(page: str) -> None:
    assert "field: timing of run by-hand-2" in page
    assert "field at 10 cycles/s in real time: 2 cycles" in page
    assert "PASS: all " in page
    assert "2 CPUs, A processor; load average 0.50 before, 0.75 after" in page
    for heading in ("Decision", "Hop", "Floor", "Counts", "Other budgets", "Processes"):
        assert f". {heading}</h2>" in page


def test_curves_are_drawn_over_percentiles_with_the_floor_beside_them(page: str) -> None:
    hops = plot(page, "percentiles-hop")
    names = [trace["name"] for trace in hops["data"]]
    assert names == ["telemetry", "residual", "setpoint", "command", "floor: timer"]
    assert hops["layout"]["xaxis"]["title"]["text"] == "percentile [%]"
    assert "99.9" in hops["layout"]["xaxis"]["ticktext"]
    loop = [trace["name"] for trace in plot(page, "percentiles-loop")["data"]]
    assert loop[:2] == ["loop all commands", "loop each command"]


def test_each_agent_has_a_row_and_the_chain_a_colour_of_its_own(page: str) -> None:
    drawn = plot(page, "waits-1")
    beside, chain, messages = drawn["data"]
    agents = ["plant", "c2/c", "c2", "central", "c2", "c2/d", "plant"]
    assert list(chain["y"]) == agents
    assert "c1/a" in list(beside["y"])
    assert beside["marker"]["color"] != chain["marker"]["color"]
    assert "c2/c took 7.9 ms to estimate" in chain["customdata"][1]
    assert list(messages["y"])[:2] == ["plant", "c2/c"]
    rows = drawn["layout"]["yaxis"]["categoryarray"]
    assert rows == ["plant", "central", "c1", "c1/a", "c1/b", "c2", "c2/c", "c2/d"]
    assert "Its longest link: c2/c took 7.9 ms to estimate." in page


def test_the_page_of_a_sweep_draws_latency_against_rate(tmp_path: Path) -> None:
    report = reported(tmp_path).report
    rows = (
        RateRow(5.0, 75, 9e3, 10e3, 12e3, clean=True, host=report.host, floor=floor_times()),
        RateRow(80.0, 300, 9e3, 30e3, 40e3, missed_deadlines=7, trouble="direct missed one"),
        RateRow(90.0, 300, 9e3, 30e3, 40e3, interrupted=True),
        RateRow(160.0, failed="recorder gave up"),
    )
    page = sweep_page(Sweep(rows, 5.0, interrupted=False), report)
    assert "highest clean rate: 5 cycles/s" in page
    assert "160 cycles/s failed: recorder gave up" in page
    assert "80 cycles/s was not clean: direct missed one" in page
    assert "at 5 cycles/s [ms]" in page
    drawn = plot(page, "rates")
    assert [trace["name"] for trace in drawn["data"]] == [
        "loop p50",
        "loop p99",
        "loop max",
        "length of a cycle",
    ]
    assert list(drawn["data"][0]["marker"]["symbol"]) == ["circle", "x"]
    assert list(drawn["data"][0]["x"]) == [5.0, 80.0]
    assert drawn["layout"]["xaxis"]["type"] == drawn["layout"]["yaxis"]["type"] == "log"


def test_the_page_of_a_sweep_that_was_interrupted_at_once_has_no_figure(tmp_path: Path) -> None:
    row = RateRow(5.0, 75, 9e3, 10e3, 12e3, interrupted=True)
    page = sweep_page(Sweep((row,), None, interrupted=True), reported(tmp_path).report)
    assert "interrupted before a rate was found to be clean" in page
    assert "rates-plot-data" not in page
