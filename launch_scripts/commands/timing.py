"""`heliarch timing`: whether a plant meets its deadlines in real time, and by how much."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import typer

from launch_scripts.commands.boundary import FAILED, INTERRUPTED, OK
from launch_scripts.commands.options import FileOptions, PageOptions, is_run, refuse_others
from launch_scripts.commands.output import publish, say
from launch_scripts.scenarios.run_options import PlantOptions, ProcessOptions, TimeOptions
from studies.tables import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from launch_scripts.launcher.run_folder import RunRequest
    from live_page.process import PageProcess
    from studies.timing.report import TimingReport
    from studies.timing.sweep import Rates

_DURATION: Final = "60s"
_SWEEP_DURATION: Final = "15s"


def timing(
    context: typer.Context,
    scenario: str = "oahu",
    *,
    rate: str = "1",
    span: TimeOptions,
    plant: PlantOptions,
    settings: list[str] | None = None,
    machine: ProcessOptions,
    processes: bool = False,
    page: PageOptions,
    files: FileOptions,
) -> int:
    """Run a plant in real time and report whether every tier meets its deadlines, and by how much.

    Given a recorded run instead of a scenario, report on that. --report writes timing.html into the
    run's folder by default.

    Exit status 1: a budget was not kept, or the run failed. A scenario states its own budgets in
    its table timing.budgets; see docs/timing.md.

    SCENARIO: A shipped scenario or a TOML file; or the folder or run.mcap of a real-time run, to
        report on it without a new run.
    --rate RATES: Cycles a second: one rate (20), several (5,10,20), or a range (1..200, auto) in
        which to find the highest rate that the plant keeps up with. A run takes 60 s, or 15 s at
        each of several rates, unless --to or --duration says otherwise.
    --processes: Show each process as well as the tiers.
    Example: heliarch timing oahu --rate 20 --duration 60s --report
    """
    from launch_scripts.commands.run import page_beside, run_request
    from studies.timing.measured_run import measured_run, prepare_at, run_length_s
    from studies.timing.report import report_on
    from studies.timing.sweep import parse_rates

    console = console_for(files.json)
    if is_run(path := Path(scenario)):
        allowed = ("scenario", "processes", "report", "json")
        why = f"expected only --processes, --report or --json with the recorded run {path}"
        refuse_others(context, allowed, why)
        return _publish_one(report_on(path, by_agent=processes), path, files)
    rates = parse_rates(rate)
    options = {**vars(span), **vars(plant), **vars(machine)}
    request = run_request(scenario, settings, files, **options)
    with page_beside(page, console) as shown:
        if rates.single_hz is None:
            length_s = run_length_s(request, _SWEEP_DURATION)
            return _time_several(rates, length_s, request, files, console, shown)
        length_s = run_length_s(request, _DURATION)
        preparation, folder = prepare_at(rates.single_hz, length_s, request, request.out)
        if shown is not None:
            say(console, f"page: {shown.show(folder.path)}")
        report = measured_run(preparation, folder, console, by_agent=processes)
        return _publish_one(report, folder.path, files)


def _publish_one(report: TimingReport, run: Path, files: FileOptions) -> int:
    from recordings.read.run_file import RECORDING_NAME
    from studies.timing.results import timing_result

    recording = run / RECORDING_NAME if run.is_dir() else run
    page = recording.with_name("timing.html")
    publish(timing_result(report), files, page, f"recording: {recording}")
    if report.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED


def _time_several(
    rates: Rates,
    length_s: float,
    request: RunRequest,
    files: FileOptions,
    console: Console,
    shown: PageProcess | None,
) -> int:
    from launch_scripts.launcher.run_folder import new_run_id, run_folder
    from studies.timing.measured_run import measured_run, prepare_at
    from studies.timing.results import sweep_result
    from studies.timing.sweep import sweep

    folder = run_folder(f"{new_run_id('timing')}-rates", request.out).path

    def timed(rate_hz: float) -> TimingReport:
        name = f"rate-{rate_hz:g}"
        if (folder / name).exists():
            name = f"{name}-again"
        preparation, place = prepare_at(rate_hz, length_s, request, folder / name)
        return measured_run(preparation, place, console)

    if shown is not None:
        say(console, f"page: {shown.show(folder, several=True)}")
    found = sweep(rates, timed)
    result = sweep_result(found, request.scenario.scenario.name)
    publish(result, files, folder / "timing.html", f"recordings: {folder}")
    if found.interrupted:
        return INTERRUPTED
    return FAILED if found.highest_clean_hz is None else OK
