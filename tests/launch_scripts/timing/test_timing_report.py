"""What must have been measured of foreign devices, and what counts after an interruption."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace
from recordings_by_hand import SCENARIO, cycle_of_the_plant
from timings_by_hand import HOST, REAL_TIME, summary_of

from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.signals import RUN
from bus_schemas.tree import ROOT
from launch_scripts.supervision import RunFailure
from launch_scripts.timing.budget_table import BudgetTable
from launch_scripts.timing.measured_run import MeasuredRun
from launch_scripts.timing.timing_report import TimingReport, report_on
from recordings.writer import RunWriter

START_NS = 5_000_000_000
EXTERNAL = ("plant", "c2/d")
PLAN = replace(REAL_TIME, external=EXTERNAL, period_cycles=(1, 1))


def cycles(count: int, *, mute_from: int, all_known: bool) -> Iterator[Delivery]:
    """Messages 1 ms apart; `c2/d` knows no time, and the other inverters leave before a cycle."""
    for cycle in range(count):
        tick_ns = START_NS + cycle * PLAN.cycle_wall_ns
        for place, (port, message) in enumerate(cycle_of_the_plant(2 * cycle)):
            left = cycle >= mute_from and port.publisher != "plant"
            if not left:
                knows_time = all_known or str(port) != "c2/d/command"
                time_ns = tick_ns + place * 1_000_000 if knows_time else 0
                yield port, replace(message, cycle=cycle, publish_time_ns=time_ns)


def report_of(folder: Path, *, interrupted: bool, all_known: bool = False) -> TimingReport:
    path = folder / "run.mcap"
    writer = RunWriter(path, PLAN, SCENARIO, driver="launch")
    begin = (RUN.of(ROOT), PLAN.run_message("start", 0, START_NS))
    for port, message in (begin, *cycles(3, mute_from=2, all_known=all_known)):
        logged_ns = max(message.publish_time_ns, START_NS + message.cycle * PLAN.cycle_wall_ns)
        writer.add(port, message, encode(message), logged_ns)
    writer.close()
    return report_of_run(path, interrupted=interrupted)


def report_of_run(path: Path, *, interrupted: bool, recording_ended: str = "") -> TimingReport:
    summary = summary_of(path.parent, interrupted=interrupted, recording_ended=recording_ended)
    report, _ = report_on(MeasuredRun(PLAN, summary, (), HOST, path, BudgetTable()))
    return report


def test_a_device_that_tells_no_time_is_not_measured_in_that_stage(tmp_path: Path) -> None:
    report = report_of(tmp_path, interrupted=False)
    rows = {row.of: row.times.count for row in report.times if row.measure == "response"}
    assert rows["c2/d estimate"] == 2
    assert "c2/d actuate" not in rows
    (verdict,) = [entry for entry in report.verdicts if entry.of == "c2/d actuate"]
    assert (verdict.value, verdict.passed) == (None, False)


def test_of_a_foreign_plant_cycles_after_the_interruption_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "ended").mkdir()
    whole = report_of(tmp_path / "whole", interrupted=False)
    ended = report_of(tmp_path / "ended", interrupted=True)
    loops = [
        row.times.count for found in (whole, ended) for row in found.times if row.of[:3] == "all"
    ]
    assert loops == [3, 2]
    assert {cycle.cycle for cycle in ended.slowest_cycles} == {0, 1}


def test_responses_come_in_the_order_of_a_cycle(tmp_path: Path) -> None:
    report = report_of(tmp_path, interrupted=False, all_known=True)
    rows = [row.of for row in report.times if row.measure == "response"]
    assert rows == ["c2/d estimate", "c2/d actuate", "plant begin", "plant advance"]


def test_a_recording_that_a_full_disk_ended_costs_only_what_it_alone_tells(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"")
    ended = "the recording ended in cycle 0"
    report = report_of_run(path, interrupted=False, recording_ended=ended)
    assert (report.slowest_cycles, report.times) == ((), ())
    assert report.remarks == (ended,)
    assert not report.passed  # What had to be measured was not.
    with pytest.raises(RunFailure, match=r"run\.mcap"):
        report_of_run(path, interrupted=False)
