"""One run of a plant in real time with the machine's floor measured beside it."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Final

from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.launcher import launch
from launch_scripts.live_view import view_for
from launch_scripts.run_command import RunRequest, prepare_run
from launch_scripts.scenario import parse_duration_s
from launch_scripts.timing.budget_table import BudgetTable
from launch_scripts.timing.floor import Floor
from launch_scripts.timing.host import host, load_average
from launch_scripts.timing.timing_report import TimedRun

_REAL_TIME: Final = "1"


def run_at(
    rate_hz: float, duration: str, request: RunRequest, console: Console, out: Path | None
) -> tuple[TimedRun, BudgetTable]:
    """Run a plant at a rate, and measure the floor beside it.

    Parameters
    ----------
    rate_hz
        Cycles a second.
    duration
        How long, in words; rounded to whole cycles.
    request
        What to run. Its duration and cycle are set here.
    console
        Shows progress.
    out
        Folder of the run.

    Returns
    -------
    tuple
        The run, and the budgets that its scenario states.

    Raises
    ------
    InputError
        The words of the command line, the scenario and its data do not go together.
    RunFailure
        The run could not go on.
    """
    began_at = time.monotonic()
    cycles = whole_cycles(rate_hz, duration)
    cycle_s = 1.0 / rate_hz
    timed = replace(
        request,
        pace=_REAL_TIME,
        cycle_s=cycle_s,
        duration=f"{cycles * cycle_s:.9f}",
        out=out,
    )
    try:
        preparation, folder = prepare_run(timed)
    except OSError as error:
        # A file that may not be read, or a name that no file can have.
        raise InputError(str(error)) from None
    plan, scenario = preparation.plan, preparation.scenario.scenario
    load_before = load_average()
    with (
        Floor(plan.run_id, plan.cycle_wall_ns, plan.machine) as floor,
        view_for(console, plan, scenario.time.timezone) as view,
    ):
        view.say(f"{scenario.title}; {rate_hz:g} cycles/s for {cycles * cycle_s:g} s")
        summary = launch(preparation, folder, view, began_at, lambda: floor.begin(cycles * cycle_s))
        rows = floor.finish()
    folder.summary.write_bytes(summary.as_json() + b"\n")
    timings = [account.timing for account in summary.processes if account.timing is not None]
    run = TimedRun(plan, summary, rows, host(timings, load_before), folder.recording)
    return run, scenario.timing.stated


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
            f"--duration {duration}: shorter than one cycle, accepted is {1.0 / rate_hz:g} s or "
            f"more at {rate_hz:g} cycles/s"
        )
    return round(duration_s * rate_hz)
