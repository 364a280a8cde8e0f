"""Late cycles name a culprit, and it was late while another program had the processor."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import command_line
import pandas as pd
import pytest
from running import small_plant

from recordings.read.reader import RunReader
from results.timing.late_cycles import LateCycle
from results.timing.report import report_on
from results.timing.stages import start_ns_of

pytestmark = [pytest.mark.processes, pytest.mark.soak]

BUSY = Path(__file__).with_name("busy_loop.py")
BURST, PERIOD = 0.8, 3.7
"""Cycles."""

Span = tuple[float, float]


@pytest.mark.parametrize("rate_hz", [1, 5, 20, 50])
def test_the_culprit_of_each_late_cycle_lacked_the_processor(rate_hz: int, tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("a busy loop before all others needs SCHED_FIFO")
    plant, folder, seconds = small_plant(tmp_path / "plant"), tmp_path / "run", max(20 / rate_hz, 8)
    words = [sys.executable, str(BUSY), "0", str(BURST / rate_hz), str(PERIOD / rate_hz)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as busy:
        options = ("--rate", str(rate_hz), "--duration", f"{seconds:g}s", "--cpus", "0")
        command_line.heliarch("timing", plant, *options, "--out", folder)
        said, _ = busy.communicate()
    bursts = [tuple(map(int, line.split())) for line in said.splitlines()]
    report = report_on(folder)
    with RunReader(folder) as reader:
        start_ns = start_ns_of(reader)
    in_run = [((began - start_ns) / 1e6, (ended - start_ns) / 1e6) for began, ended in bursts]
    assert len(report.late) >= 3, "a burst is longer than each stage may take"
    assert all(one.culprit and one.cause and one.text for one in report.late)
    cycle_ms = 1e3 / rate_hz
    hit = [
        one
        for one in report.late
        if overlap((one.cycle * cycle_ms, (one.cycle + 1) * cycle_ms), in_run) > 0.4 * cycle_ms
    ]
    right = [one for one in hit if overlap(when(one, report.stages, cycle_ms), in_run) > 0.0]
    print(f"{rate_hz} Hz: {len(report.late)} late, {len(hit)} with a burst, {len(right)} in it")
    assert len(right) >= 0.9 * len(hit) > 0


def when(late: LateCycle, stages: pd.DataFrame, cycle_ms: float) -> Span:
    """From when to when the culprit took too long, after the tick of cycle 0 [ms]."""
    agent = late.culprit.rpartition(" to ")[2]
    rows = stages[(stages.cycle == late.cycle) & (stages.agent == agent)]
    rows, tick = rows[rows.stage == late.stage], late.cycle * cycle_ms
    if rows.empty or late.ms == float("inf"):
        return tick, tick + cycle_ms
    row = rows.iloc[0]
    end = {"hop": row["ready"], "tick": row["first"]}.get(late.cause, row["published"])
    return tick + end - late.ms, tick + end


def overlap(span: Span, bursts: Sequence[Span]) -> float:
    return sum(max(min(span[1], end) - max(span[0], begin), 0.0) for begin, end in bursts)
