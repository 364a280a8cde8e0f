"""The page of a timed run: verdict, slowest cycles, loop time and budgets, tables."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from reports_by_hand import missed, reported
from timed_recordings import cycle

from studies.report.page import html_page
from studies.timing.report import TimingReport
from studies.timing.results import sweep_result, timing_result
from studies.timing.sweep import RateRow, Sweep


def run_page(found: TimingReport) -> str:
    return html_page(timing_result(found))


def plot(page: str, anchor: str) -> dict[str, Any]:
    """Data and layout of a figure, as they stand in the page."""
    found = re.search(rf'id="{anchor}-plot-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None, anchor
    document: dict[str, Any] = json.loads(found[1])
    return document


def names(drawn: dict[str, Any]) -> list[str]:
    return [trace["name"] for trace in drawn["data"]]


@pytest.fixture
def page(tmp_path: Path) -> str:
    return run_page(reported(tmp_path))


def test_the_page_begins_with_the_verdict_and_the_slowest_cycle(page: str, tmp_path: Path) -> None:
    verdict = page.index('<p class="verdict pass">PASS: all ')
    assert verdict < page.index("2 cycles") < page.index('<section id="waits-1"')
    assert re.findall(r'<section id="([a-z0-9-]+)"', page)[:4] == [
        "waits-1",
        "waits-2",
        "loop",
        "percentiles-loop",
    ]
    failed = run_page(reported(tmp_path / "late", cycle(0), missed(1)))
    assert '<p class="verdict fail">FAIL: ' in failed
    assert "not kept: " in failed


def test_the_loop_time_is_drawn_over_time_and_budgets_are_lines(page: str) -> None:
    drawn = plot(page, "loop")
    assert names(drawn) == ["loop time", "budget 50 ms"]
    assert list(drawn["data"][0]["x"]) == [0.0, 0.1]
    assert list(drawn["data"][0]["y"]) == [13.6, 13.6]
    hops = plot(page, "percentiles-hop")
    signals = ("telemetry", "residual", "setpoint", "command")
    assert names(hops) == [*(f"hop {signal}" for signal in signals), "budget 10 ms"]
    assert set(hops["data"][-1]["y"]) == {10.0}


def test_each_agent_has_a_row_and_the_chain_a_colour_of_its_own(page: str) -> None:
    drawn = plot(page, "waits-1")
    others, chain, messages = drawn["data"]
    assert list(chain["y"]) == ["plant", "c2/c", "c2", "central", "c2", "c2/d", "plant"]
    assert "c1/a" in list(others["y"])
    assert others["marker"]["color"] != chain["marker"]["color"]
    assert "c2/c took 7.9 ms (estimate)" in chain["customdata"][1]
    assert list(messages["y"])[:2] == ["plant", "c2/c"]
    rows = drawn["layout"]["yaxis"]["categoryarray"]
    assert rows == ["plant", "central", "c1", "c1/a", "c1/b", "c2", "c2/c", "c2/d"]


def test_the_page_of_a_sweep_draws_loop_time_against_rate(tmp_path: Path) -> None:
    report = reported(tmp_path)
    rows = (
        RateRow(5.0, "clean", "", 75, 0, 0, 9e3, 10e3, 12e3, report.host),
        RateRow(80.0, "not clean", "direct missed one", 300, 7, 0, 9e3, 30e3, 40e3),
        RateRow(90.0, "interrupted", "", 300, 0, 0, 9e3, 30e3, 40e3),
        RateRow(160.0, "failed", "recorder gave up"),
    )
    page = html_page(sweep_result(Sweep(rows, 5.0), "field"))
    assert '<p class="verdict pass">highest clean rate: 5 cycles/s' in page
    assert "160 cycles/s failed: recorder gave up" in page
    drawn = plot(page, "rates")
    assert names(drawn) == ["loop p50", "loop p99", "loop max", "length of a cycle"]
    assert list(drawn["data"][0]["marker"]["symbol"]) == ["circle", "x"]
    assert list(drawn["data"][0]["x"]) == [5.0, 80.0]
