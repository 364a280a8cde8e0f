"""One run of a plant in real time with the machine's floor measured beside it."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from bus_schemas.errors import InputError
from bus_schemas.times import parse_duration_s
from launch_scripts.launcher.interruption import interruptible
from launch_scripts.launcher.launch import launch
from launch_scripts.launcher.live_view import view_for
from launch_scripts.launcher.request import RunRequest, prepare_run
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.supervision import ForkServerProcess, RunFailure
from launch_scripts.scenarios.preparation import Preparation
from studies.timing.floor import Floor
from studies.timing.host import load_average, this_host
from studies.timing.rates import cycles_per_s
from studies.timing.report import Reported, report_on

_REAL_TIME: Final = "1"


def prepare_at(
    rate_hz: float, duration: str, request: RunRequest, out: Path | None
) -> tuple[Preparation, RunFolder]:
    """Work out a run at a rate, and its folder, of which nothing is made yet.

    Parameters
    ----------
    rate_hz
        Cycles a second.
    duration
        How long, in words; rounded to whole cycles.
    request
        What to run. Its duration and cycle are set here.
    out
        Folder of the run.

    Raises
    ------
    InputError
        The words of the command line, the scenario and its data do not go together.
    """
    cycle_s = 1.0 / rate_hz
    duration_s = whole_cycles(rate_hz, duration) * cycle_s
    timed = replace(
        request, pace=_REAL_TIME, cycle_s=cycle_s, duration=f"{duration_s:.9f}", out=out
    )
    try:
        return prepare_run(timed)
    except OSError as error:
        # A file that may not be read, or a name that no file can have.
        raise InputError(str(error)) from None


def measured_run(
    preparation: Preparation, folder: RunFolder, console: Console, *, by_agent: bool = False
) -> Reported:
    """Run a plant that is prepared, measure the floor beside it, and report on it.

    Parameters
    ----------
    preparation, folder
        See `prepare_at`.
    console
        Shows progress.
    by_agent
        Whether each process gets rows of its own.

    Raises
    ------
    InputError
        The folder or the ports cannot be had.
    OSError
        What the processes need cannot be written: the disk is full.
    RunFailure
        The run could not go on, or its recording cannot be read.
    """
    plan, scenario = preparation.plan, preparation.scenario.scenario
    duration_s = plan.cycles * plan.cycle_wall_ns / 1e9
    began_at, load_before = time.monotonic(), load_average()
    with (
        ForkServerProcess() as server,
        Floor(plan.run_id, plan.cycle_wall_ns, plan.machine) as floor,
        view_for(console, plan, scenario.time.timezone) as view,
    ):
        view.say(scenario.title)
        view.say(f"{cycles_per_s(1e9 / plan.cycle_wall_ns)} for {round(duration_s, 2):g} s")
        begin_floor = partial(floor.begin, duration_s)
        summary = launch(preparation, folder, view, began_at, server, begin_floor)
        with interruptible():  # The run is over: Ctrl-C throws nothing away any more.
            rows = floor.finish()
            folder.summary.write_bytes(summary.as_json() + b"\n")
    host = this_host(plan, summary.remarks, load_before)
    try:
        return report_on(folder.path, summary, host, rows, by_agent=by_agent)
    except InputError as error:  # The disk was full, for instance.
        raise RunFailure(f"{summary.recording_ended or 'not measured'}: {error}") from None


def whole_cycles(rate_hz: float, duration: str) -> int:
    """Return how many cycles a duration holds.

    Raises
    ------
    InputError
        It is none, or holds no whole cycle.
    """
    duration_s = parse_duration_s(duration, "--duration")
    if duration_s * rate_hz < 1.0:
        raise InputError(
            f"--duration {duration}: shorter than one cycle, expected {1.0 / rate_hz:g} s or "
            f"more at {cycles_per_s(rate_hz)}"
        )
    return round(duration_s * rate_hz)
