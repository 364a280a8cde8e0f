"""The table at the end of a run, and the same as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from printing import printed
from reports_by_hand import summary_of as summary_by_hand

from agents.events import ExternalAccount
from launch_scripts.launcher.summary import MessageCount, ProcessAccount, RunSummary
from launch_scripts.launcher.summary_table import print_summary, summary_table
from recordings.read.series import RunSeries
from studies.metrics import RunMetrics, run_metrics


def metrics_of(regulation: bool) -> RunMetrics:
    """Return the metrics of an hour in which a plant of 100 MW is half of the time 10 MW short."""
    cycles = 3600
    signal_kw = 9_000.0 * np.sin(np.arange(cycles) / 30.0 + 0.1) * regulation
    delivered_kw = 50_000.0 + signal_kw - 10_000.0 * (np.arange(cycles) % 2)
    one = np.ones((cycles, 1))
    return run_metrics(
        RunSeries(
            label="hierarchical",
            inverters=("c1/inv01",),
            rating_kw=np.array([100_000.0]),
            timezone="Pacific/Honolulu",
            start_time_ns=1_270_159_200_000_000_000,
            cycle_s=1.0,
            commitment_kw=np.full(cycles, 50_000.0),
            regulation_kw=signal_kw,
            regulation_capacity_kw=9_000.0 * regulation,
            mpp_kw=90_000.0 * one,
            power_kw=delivered_kw[:, None],
            impp_kw=90_000.0 * one,
            residual_kw=40_000.0 * one,
            alpha=0.5 * one,
        )
    )


def summary_of(metrics: RunMetrics | None) -> RunSummary:
    return replace(
        summary_by_hand(Path("runs/r")),
        cycles=3600,
        cycle_s=1.0,
        metrics=metrics,
        messages=(MessageCount("help", 12, 12), MessageCount("production", 3600, 3600)),
        processes=(),
    )


def rows_of(summary: RunSummary) -> dict[str, list[str]]:
    return {name: cells for name, *cells in summary_table(summary).texts()}


@pytest.mark.parametrize("width", [80, 100])
def test_every_row_is_printed_whole(width: int) -> None:
    summary = summary_of(metrics_of(regulation=True))
    text = printed(lambda console: print_summary(summary, console), width)
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    for row in summary_table(summary).texts():
        assert all(word in words for cell in row for word in cell.split())


def test_figures_of_merit_are_told_that_the_run_defines() -> None:
    rows = rows_of(summary_of(metrics_of(regulation=False)))
    # Half of the cycles are 10,000 kW short: the root of half of 10,000 squared.
    assert rows["Tracking RMSE"][:2] == ["7,071.07", "kW"]
    # 3,599 steps of 10,000 kW in the hour
    assert rows["Mileage per hour"][:2] == ["35,990,000", "kW/h"]
    assert rows["Shortfall"] == ["5,000.00", "kWh", "10.000 % of desired"]
    assert "PJM performance score" not in rows
    regulated = rows_of(summary_of(metrics_of(regulation=True)))
    # Each request of 2 s has a second that is short; of the multiples of 10 s none is.
    assert regulated["Requests fulfilled to 1 %"][0] == "0.00"
    assert regulated["PJM performance score"][0] == "1.000"


def test_a_run_without_a_complete_cycle_has_no_figures_and_says_so() -> None:
    rows = rows_of(summary_of(None))
    assert rows["Figures of merit"][0] == "-"
    assert "Tracking RMSE" not in rows


def test_the_json_has_all_metrics_and_the_figures_by_name() -> None:
    document = json.loads(summary_of(metrics_of(regulation=True)).as_json())
    assert document["figures"]["satisfied"] == pytest.approx(90.0, abs=0.1)
    assert document["metrics"]["tracking"]["mae_kw"] == pytest.approx(5000.0)
    assert document["metrics"]["regulation"]["performance"]["hours"][0]["windows"] == 12


def test_a_run_over_processes_tells_what_it_took_and_which_cycles_were_skipped() -> None:
    processes = (
        ProcessAccount("recorder", "recorder", {}, 40.0, cpu_s=3.6),
        ProcessAccount("c1/a", "direct", {}, 40.0, skipped_cycles=2, cpu_s=3.6),
        ProcessAccount("c1/b", "direct", {}, 40.0, skipped_cycles=5),
    )
    found = replace(
        summary_of(None), processes=processes, missing_inputs=13, old_inputs=4, skipped_cycles=7
    )
    rows = rows_of(found)
    assert rows["Processor time per cycle"][:2] == ["2.00", "ms"]
    assert rows["Inputs missed at deadlines"][0] == "13"
    assert "4" in rows["Inputs missed at deadlines"][2]
    assert rows["Cycles skipped"][0] == "7"
    assert "c1/b" in rows["Cycles skipped"][2]
    assert "Cycles skipped" not in rows_of(summary_of(None))


def test_cycles_that_no_recorder_saw_are_told() -> None:
    summary = replace(summary_of(None), messages=(MessageCount("production", 3600, 3589),))
    rows = rows_of(summary)
    assert rows["Cycles"][0] == "3,600"
    assert "3,589 of them recorded" in rows["Cycles"][2]
    assert rows["Cycle rate"][0] == "360.0"
    assert json.loads(summary.as_json())["cycles_per_s"] == 360.0


def test_messages_of_a_device_that_were_lost_are_counted_as_lost() -> None:
    device = ExternalAccount("c1/inv01", {"impp": 5}, lost=100, expected=20, answered=5)
    rows = rows_of(replace(summary_of(None), external=(device,)))
    assert rows["Missing in the recording"][0] == "100"
    assert rows["External c1/inv01"][0] == "5"
    assert "100" in rows["External c1/inv01"][2]
