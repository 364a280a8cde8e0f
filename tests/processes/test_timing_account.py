"""What the processes of a run in real time measure of themselves, and take of the machine."""

from __future__ import annotations

import os
from collections.abc import Callable

import msgspec
import pytest
from running import Heliarch

from agents.machine import MachineSettings, refusals
from bus_schemas.messages import Timing
from bus_schemas.signals import PLANT_TIMING, TIMING
from launch_scripts.summary import ProcessAccount, RunSummary
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]

PRIORITY = 7


def test_processes_run_where_and_how_they_are_told_and_count_alike_everywhere(
    heliarch: Start,
) -> None:
    cpu = str(max(os.sched_getaffinity(0)))
    words = ("--pace", "10", "--duration", "15", "--cpus", f"direct={cpu}")
    run = heliarch("launch", "oahu", *words, "--priority", str(PRIORITY))
    run.wait()  # On a slow machine messages may get lost: then the run says so.
    document = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    summary = msgspec.convert(document, RunSummary)
    refused = refusals(MachineSettings(priority=PRIORITY), lockstep=False)
    assert [remark for remark in summary.remarks if "SCHED_FIFO" in remark] == list(refused)
    rank = "other" if refused else f"fifo {PRIORITY}"
    for process in summary.processes:
        if process.timing is not None:
            policy, _, cpus = process.timing.policy.partition(" on CPU ")
            assert policy == rank
            assert cpus == cpu or process.kind != "direct"
    # What each counted of itself at the end is what it last said on the bus, if it said anything.
    said: dict[str, Timing] = {}
    with RunReader(run.folder) as reader:
        for _, message in reader.messages(TIMING, PLANT_TIMING):
            assert isinstance(message, Timing)
            said[message.source] = message
    if any(count.lost for count in summary.messages if count.signal in ("timing", "plant_timing")):
        return  # Of a message that a slow machine has lost, nobody knows whose it was.
    for process in summary.processes:
        counted = counts_of(process)
        assert said[process.agent].counts == counted if any(counted) else process.agent not in said


def counts_of(process: ProcessAccount) -> tuple[int, ...]:
    timing = process.timing
    if timing is None:
        return ()
    return (
        sum(timing.missed_deadlines.values()),
        sum(timing.missing_inputs.values()),
        timing.late_used,
        sum(timing.overruns.values()),
        sum(process.dropped.values()),
    )
