"""A plant run in real time at a stated rate, and its timing."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import psutil

from agents.process.interruption import interruptible
from bus_schemas.errors import InputError
from launch_scripts.launch import check_processes, launch
from launch_scripts.run_folder import RunFolder, RunRequest, prepare_run
from launch_scripts.supervision import ForkServerProcess, RunFailure
from launch_scripts.view import ViewFor
from results.timing.report import TimingReport, report_on
from results.timing.tables import cycles_per_s
from scenarios.preparation import Preparation
from scenarios.times import parse_duration_s


def run_length_s(request: RunRequest, default: str) -> float:
    """Return how long a run lasts: up to `--to`, or for `--duration` or its default [s]."""
    if request.options.end is None:
        return parse_duration_s(request.options.duration or default, "--duration")
    plan = prepare_run(request)[0].plan
    return plan.timing.cycles * plan.timing.cycle_ns / 1e9


def prepare_at(
    rate_hz: float, length_s: float, request: RunRequest, out: Path | None
) -> tuple[Preparation, RunFolder]:
    """Prepare a run at a rate, its length rounded to whole cycles. Nothing is written yet."""
    if length_s * rate_hz < 1.0:
        raise InputError(
            f"--duration {length_s:g} s: shorter than one cycle, expected {1.0 / rate_hz:g} s or "
            f"more at {cycles_per_s(rate_hz)}"
        )
    cycle_s = 1.0 / rate_hz
    duration = f"{round(length_s * rate_hz) * cycle_s:.9f}"
    options = replace(request.options, pace="1", cycle_s=cycle_s, duration=duration, end=None)
    preparation, folder = prepare_run(RunRequest(request.scenario, options, out))
    check_processes(preparation.plan)
    return preparation, folder


def measured_run(
    preparation: Preparation, folder: RunFolder, view_for: ViewFor, *, by_agent: bool = False
) -> TimingReport:
    """Run a plant that `prepare_at` has prepared, and report on it."""
    plan, scenario = preparation.plan, preparation.scenario.scenario
    duration_s = plan.timing.cycles * plan.timing.cycle_wall_ns / 1e9
    began_at, load_before = time.monotonic(), psutil.getloadavg()[0]
    with (
        ForkServerProcess() as server,
        view_for(plan) as view,
    ):
        view.say(scenario.title)
        view.say(f"{cycles_per_s(1e9 / plan.timing.cycle_wall_ns)} for {round(duration_s, 2):g} s")
        summary = launch(preparation, folder, view, began_at, server)
        with interruptible():  # The run is over: Ctrl-C throws nothing away any more.
            folder.write_summary(summary.as_json())
    load = load_before, psutil.getloadavg()[0]
    try:
        return report_on(folder.path, summary, load, by_agent=by_agent)
    except InputError as error:  # The disk was full, for instance.
        raise RunFailure(f"{summary.recording_ended or 'not measured'}: {error}") from None
