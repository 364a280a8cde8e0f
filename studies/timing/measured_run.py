"""A plant run in real time at a stated rate, and its timing."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import psutil
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
from studies.timing.rates import cycles_per_s
from studies.timing.report import Reported, report_on

_REAL_TIME: Final = "1"


def prepare_at(
    rate_hz: float, duration: str, request: RunRequest, out: Path | None
) -> tuple[Preparation, RunFolder]:
    """Prepare a run at a rate, its duration rounded to whole cycles. Nothing is written yet.

    Raises
    ------
    InputError
        Command line, scenario and data do not fit together.
    """
    cycle_s = 1.0 / rate_hz
    duration_s = whole_cycles(rate_hz, duration) * cycle_s
    options = replace(
        request.options, pace=_REAL_TIME, cycle_s=cycle_s, duration=f"{duration_s:.9f}"
    )
    try:
        return prepare_run(RunRequest(request.scenario, options, out))
    except OSError as error:
        # A file that must not be read, or a name that no file can have.
        raise InputError(str(error)) from None


def measured_run(
    preparation: Preparation, folder: RunFolder, console: Console, *, by_agent: bool = False
) -> Reported:
    """Run a plant that `prepare_at` has prepared, and report on it.

    Raises
    ------
    InputError
        The folder or the ports are not available.
    OSError
        A file that the processes need cannot be written.
    RunFailure
        The run could not go on, or its recording cannot be read.
    """
    plan, scenario = preparation.plan, preparation.scenario.scenario
    duration_s = plan.cycles * plan.cycle_wall_ns / 1e9
    began_at, load_before = time.monotonic(), _load_average()
    with (
        ForkServerProcess() as server,
        view_for(console, plan, scenario.time.timezone) as view,
    ):
        view.say(scenario.title)
        view.say(f"{cycles_per_s(1e9 / plan.cycle_wall_ns)} for {round(duration_s, 2):g} s")
        summary = launch(preparation, folder, view, began_at, server)
        with interruptible():  # The run is over: Ctrl-C throws nothing away any more.
            folder.summary.write_bytes(summary.as_json() + b"\n")
    load = load_before, _load_average()
    try:
        return report_on(folder.path, summary, load, by_agent=by_agent)
    except InputError as error:  # The disk was full, for instance.
        raise RunFailure(f"{summary.recording_ended or 'not measured'}: {error}") from None


def _load_average() -> float:
    return float(psutil.getloadavg()[0])


def whole_cycles(rate_hz: float, duration: str) -> int:
    """Return how many cycles a duration holds; refuse one without a whole cycle."""
    duration_s = parse_duration_s(duration, "--duration")
    if duration_s * rate_hz < 1.0:
        raise InputError(
            f"--duration {duration}: shorter than one cycle, expected {1.0 / rate_hz:g} s or "
            f"more at {cycles_per_s(rate_hz)}"
        )
    return round(duration_s * rate_hz)
