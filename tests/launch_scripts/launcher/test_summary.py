"""The table at the end of a run, and the same as JSON."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from agents.events import ExternalAccount
from launch_scripts.launcher.summary import (
    MemoryUse,
    MessageCount,
    ProcessAccount,
    RunSummary,
)
from launch_scripts.launcher.summary_table import print_summary
from launch_scripts.launcher.wrong_messages import WrongMessages
from recordings.read.series import RunSeries
from studies.metrics import RunMetrics, run_metrics

WIDTH = 100


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
    return RunSummary(
        run_id="r",
        scenario="oahu",
        driver="simulate",
        folder="runs/r",
        sim_start="2010-04-01 12:00:00 HST",
        cycles=3600,
        cycle_s=1.0,
        wall_s=10.0,
        startup_s=1.0,
        arming_rounds=0,
        metrics=metrics,
        messages=(MessageCount("help", 12, 12),),
        dropped={},
        missing_inputs=0,
        memory=(MemoryUse("simulation", 1, 100.0, 100.0, 90.0),),
        hindsight_neighbours=False,
        remarks=(),
        interrupted=False,
    )


def rows_of(metrics: RunMetrics | None) -> dict[str, list[str]]:
    return rows_printed(summary_of(metrics))


def rows_printed(summary: RunSummary) -> dict[str, list[str]]:
    """Print a summary; return its rows by name, after checking that none is cut or too long."""
    text = io.StringIO()
    print_summary(summary, Console(file=text, width=200))
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= WIDTH
    cells = [line.strip("│ ").split("│") for line in lines if line.startswith("│")]
    names = [row[0].strip() for row in cells]
    return {
        name: [cell.strip() for row in cells if row[0].strip() == name for cell in row[1:]]
        for name in names
    }


def test_tracking_and_mileage_are_told() -> None:
    rows = rows_of(metrics_of(regulation=False))
    # Half of the cycles are 10,000 kW short: the root of half of 10,000 squared, and the half.
    assert rows["tracking error"] == ["7,071.07 kW", "RMSE; mean absolute 5,000.00 kW"]
    # 3,599 steps of 10,000 kW in the hour
    assert rows["support mileage"] == ["35,990,000 kW/h", "35,990,000 kW in all"]
    assert "regulation requests" not in rows
    assert "PJM performance score" not in rows


def test_requests_and_score_are_told_when_there_is_regulation() -> None:
    rows = rows_of(metrics_of(regulation=True))
    # Each request of 2 s has a second that is short.
    assert rows["regulation requests"] == [
        "0.00 %",
        "of 1,800 fulfilled, to 0.1 % of the rating",
        "0.00 %",
        "of 1,800 fulfilled, to 1 % of the rating",
    ]
    score, note = rows["PJM performance score"]
    # Of the seconds that are multiples of 10 none is short.
    assert (score, note) == (
        "1.000",
        "accuracy 1.00, delay 1.00, precision 1.00",
    )


def test_a_run_without_a_complete_cycle_has_no_figures_and_says_so() -> None:
    rows = rows_of(None)
    assert rows["energy"] == ["-", "no cycle was completed"]
    assert "tracking error" not in rows


@pytest.mark.parametrize("regulation", [False, True])
def test_the_json_has_all_metrics(regulation: bool) -> None:
    document = json.loads(summary_of(metrics_of(regulation)).as_json())
    assert document["metrics"]["tracking"]["mae_kw"] == pytest.approx(5000.0)
    found = document["metrics"]["regulation"]
    assert (found is not None) == regulation
    if regulation:
        assert found["performance"]["hours"][0]["windows"] == 12


def test_a_run_over_processes_tells_what_it_took_and_which_cycles_were_skipped() -> None:
    processes = (
        ProcessAccount("recorder", "recorder", {}, 40.0, cpu_s=3.6),
        ProcessAccount("c1/a", "direct", {}, 40.0, skipped_cycles=2, cpu_s=3.6),
        ProcessAccount("c1/b", "direct", {}, 40.0, skipped_cycles=5),
    )
    found = replace(
        summary_of(None), processes=processes, missing_inputs=13, old_inputs=4, skipped_cycles=7
    )
    rows = rows_printed(found)
    assert rows["processor time per cycle"][0] == "2.00 ms"
    assert rows["inputs missed at deadlines"][0] == "13"
    assert "4" in rows["inputs missed at deadlines"][1]
    assert rows["cycles skipped"][0] == "7"
    assert "c1/b" in rows["cycles skipped"][1]


def test_a_run_in_one_process_skips_no_cycles() -> None:
    assert "cycles skipped" not in rows_of(None)


def test_messages_that_a_device_lost_are_in_the_total() -> None:
    device = ExternalAccount("c1/inv01", {"impp": 5}, lost=100, expected=20, answered=5)
    summary = replace(summary_of(None), external=(device,))
    rows = rows_printed(summary)
    assert rows["external c1/inv01"] == ["5", "messages recorded; answered 5 times of 20"]
    assert rows["messages lost"][0] == "100"
    assert "100" in rows, "a row without a name"
    assert (summary.lost, summary.lost_by_processes) == (100, 0)
    assert "0" not in rows_printed(replace(summary, external=(replace(device, lost=0),)))


def test_what_one_device_does_wrong_on_all_its_keys_is_one_row() -> None:
    wrong = tuple(
        WrongMessages(f"c1/inv01/{signal}", "late", 2, "of a cycle that was over", "c1/inv01")
        for signal in ("impp", "residual", "help", "command")
    )
    rows = rows_printed(replace(summary_of(None), wrong=wrong))
    assert rows["wrong: c1/inv01/impp and 3 more"] == ["8", "late: of a cycle that was over"]
