"""The page of a run has its tables, percentile curves and who waited for whom."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from timings_by_hand import HOST, TREE, encoded, report

from bus_schemas.errors import InputError
from bus_schemas.signals import COMMAND, PRODUCTION, SETPOINT, TELEMETRY
from bus_schemas.tree import ROOT
from launch_scripts.timing.distributions import distribution, merged
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.sweep import RateRow, Sweep
from launch_scripts.timing.timing_page import write_page, write_sweep_page
from recordings.cycle_waits import CycleWaits, Wait

MS = 1_000_000
TELEMETRY_D, COMMAND_D = TELEMETRY.of("c2/d"), COMMAND.of("c2/d")

CHAIN = (
    Wait("plant", "begin", None, TELEMETRY_D, 0, 1 * MS, ()),
    Wait("c2/d", "actuate", TELEMETRY_D, COMMAND_D, 1 * MS, 20 * MS, ()),
    Wait("plant", "advance", COMMAND_D, PRODUCTION.of(ROOT), 20 * MS, 21 * MS, ()),
)
BESIDE = Wait("c1/a", "actuate", SETPOINT.of("c1/a"), COMMAND.of("c1/a"), 2 * MS, 3 * MS, ())
CYCLE = CycleWaits(7, 21 * MS, CHAIN, (*CHAIN, BESIDE))

FLOOR = (FloorTimes("timer", distribution(merged([encoded([0.05, 0.25])]))),)


def plot(page: str, anchor: str) -> dict[str, Any]:
    """Data and layout of a figure, as they stand in the page."""
    found = re.search(rf'id="{anchor}-plot-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None, anchor
    document: dict[str, Any] = json.loads(found[1])
    return document


@pytest.fixture
def page(tmp_path: Path) -> str:
    path = tmp_path / "timing.html"
    write_page(path, report(floor=FLOOR), [CYCLE], TREE)
    return path.read_text(encoding="utf-8")


def test_the_page_says_what_was_run_on_what_and_the_verdict(page: str) -> None:
    assert "field: timing of run by-hand-2" in page
    assert "field at 12.5 cycles/s in real time: 2 cycles" in page
    assert "PASS: all " in page
    assert "2 CPUs, A processor; load average 0.50 before, 0.75 after" in page
    for heading in ("Durations", "Counts and shares by tier", "Budgets", "Processes"):
        assert f". {heading}</h2>" in page


def test_curves_are_drawn_over_percentiles_with_the_floor_beside_them(page: str) -> None:
    hops = plot(page, "percentiles-hop")
    assert [trace["name"] for trace in hops["data"]] == ["impp", "command", "floor: timer"]
    assert hops["layout"]["xaxis"]["title"]["text"] == "percentile [%]"
    assert hops["layout"]["yaxis"]["title"]["text"] == "duration [ms]"
    assert "99.9" in hops["layout"]["xaxis"]["ticktext"]
    loop = [trace["name"] for trace in plot(page, "percentiles-loop")["data"]]
    assert loop[:2] == ["loop all commands", "loop each command"]


def test_each_agent_has_a_row_and_the_chain_a_colour_of_its_own(page: str) -> None:
    drawn = plot(page, "waits-1")
    beside, chain, messages = drawn["data"]
    assert list(chain["y"]) == ["plant", "c2/d", "plant"]
    assert list(beside["y"]) == ["c1/a"]
    assert beside["marker"]["color"] != chain["marker"]["color"]
    assert "c2/d took 19.0 ms to command" in chain["customdata"][1]
    assert list(messages["y"]) == ["plant", "c2/d", None, "c2/d", "plant", None]
    rows = drawn["layout"]["yaxis"]["categoryarray"]
    assert rows == ["plant", "central", "c1", "c1/a", "c1/b", "c2", "c2/c", "c2/d"]
    assert "Its longest link: c2/d took 19.0 ms to command." in page


def test_the_page_of_a_sweep_draws_latency_against_rate(tmp_path: Path) -> None:
    rows = (
        RateRow(5.0, 75, 9e3, 10e3, 12e3, clean=True, host=HOST, floor=FLOOR),
        RateRow(80.0, 300, 9e3, 30e3, 40e3, missed_deadlines=7, trouble="direct missed one"),
        RateRow(90.0, 300, 9e3, 30e3, 40e3, interrupted=True),
        RateRow(160.0, failed="recorder gave up"),
    )
    path = tmp_path / "timing.html"
    write_sweep_page(path, Sweep(rows, 5.0, interrupted=False), report())
    page = path.read_text(encoding="utf-8")
    assert "highest clean rate: 5 cycles/s" in page
    assert "160 cycles/s failed: recorder gave up" in page
    assert "80 cycles/s was not clean: direct missed one" in page
    assert "floor: timer, at 5 cycles/s" in page
    assert "2 CPUs, A processor; load average 0.50 before" in page
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
    path = tmp_path / "timing.html"
    row = RateRow(5.0, 75, 9e3, 10e3, 12e3, interrupted=True)
    write_sweep_page(path, Sweep((row,), None, interrupted=True), report())
    page = path.read_text(encoding="utf-8")
    assert "interrupted before a rate was found to be clean" in page
    assert "rates-plot-data" not in page


def test_a_page_that_cannot_be_written_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="accepted is a file that may be written"):
        write_page(tmp_path / "absent" / "timing.html", report(), [CYCLE], TREE)
