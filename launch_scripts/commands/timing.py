"""`heliarch timing`: whether a plant meets its deadlines in real time, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import FAILED, INTERRUPTED, OK
from launch_scripts.commands.options import (
    FileOptions,
    PageOptions,
    PlantOptions,
    ProcessOptions,
    StartOption,
)
from launch_scripts.commands.output import say, write_json, write_page
from studies.tables import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from launch_scripts.launcher.request import RunRequest
    from live_page.process import PageProcess
    from studies.timing.rates import Rates
    from studies.timing.report import Reported, TimingReport

EXAMPLE: Final = "heliarch timing oahu --rate 20 --duration 60s --report"

_RATE: Final = "1"
_DURATION: Final = "60s"
_SWEEP_DURATION: Final = "15s"


@dataclass(frozen=True, slots=True)
class _Output:
    """How the result is shown, and where it is written: the values of the options."""

    console: Console
    json: str | None
    report: str | None
    by_agent: bool


def timing(
    scenario: Annotated[
        str,
        typer.Argument(
            help="A shipped scenario or a TOML file; or the folder or run.mcap of a real-time "
            "run, to report on it without a new run."
        ),
    ] = "oahu",
    *,
    rate: Annotated[
        str | None,
        typer.Option(
            help="Cycles a second: 20; several: 5,10,20; a range such as 1..200, or auto: find the "
            "highest rate that the plant keeps up with. Default 1.",
            metavar="RATES",
        ),
    ] = None,
    start: StartOption = None,
    duration: Annotated[
        str | None,
        typer.Option(
            help="Length of the run, simulated and real: seconds, or 90s, 10m; default 60s, 15s "
            "for each of several rates.",
            metavar="TIME",
        ),
    ] = None,
    plant: PlantOptions,
    machine: ProcessOptions,
    processes: Annotated[
        bool, typer.Option("--processes", help="Show each process as well as the tiers.")
    ] = False,
    page: PageOptions,
    files: FileOptions,
) -> int:
    """Run a plant in real time and report whether every tier meets its deadlines, and by how much.

    With a recorded run instead of a scenario, report on that.

    Exit status 1: a budget was not kept, or the run failed. A scenario states its own budgets in
    its table timing.budgets; see docs/timing.md.
    """
    from launch_scripts.commands.page import page_beside
    from launch_scripts.commands.run import run_request
    from studies.timing.rates import parse_rates

    output = _Output(console_for(files.json), files.json, files.report, processes)
    if (path := Path(scenario)).is_dir() or path.suffix == ".mcap":
        options = {
            "--rate": rate, "--duration": duration, "--out": files.out, "--from": start,
            "--seed": plant.seed, "--scheme": plant.scheme, "--actuator": plant.actuator,
            "--set": plant.settings, "--fault": plant.faults, "--external": machine.external,
            "--base-port": machine.base_port, "--cpus": machine.cpus,
            "--priority": machine.priority, "--page": page.page or None,
            "--page-port": page.page_port, "--page-address": page.page_address,
        }  # fmt: skip
        _check_recorded(path, options)
        return _time_recorded(path, output)
    rates = parse_rates(_RATE if rate is None else rate)
    request = run_request(scenario, files, plant, machine, start=start)
    with page_beside(page, output.console) as shown:
        if rates.single_hz is not None:
            return _time_one(rates.single_hz, duration or _DURATION, request, output, shown)
        return _time_several(rates, duration or _SWEEP_DURATION, request, output, shown)


def _check_recorded(path: Path, options: Mapping[str, object]) -> None:
    for option, given in options.items():
        if given is not None:
            raise InputError(
                f"{option}: expected only --processes, --report or --json with {path}, which was "
                "run already"
            )


def _time_recorded(path: Path, output: _Output) -> int:
    from studies.timing.report import report_on

    return _print_one(report_on(path, by_agent=output.by_agent), path, output)


def _time_one(
    rate_hz: float, duration: str, request: RunRequest, output: _Output, shown: PageProcess | None
) -> int:
    from studies.timing.measured_run import measured_run, prepare_at

    preparation, folder = prepare_at(rate_hz, duration, request, request.out)
    if shown is not None:
        say(output.console, f"page: {shown.show(folder.path)}")
    reported = measured_run(preparation, folder, output.console, by_agent=output.by_agent)
    return _print_one(reported, folder.path, output)


def _print_one(reported: Reported, run: Path, output: _Output) -> int:
    """Print and write the result of a run."""
    from studies.timing.page import PAGE_NAME, run_page
    from studies.timing.tables import print_report

    report = reported.report
    folder = run if run.is_dir() else run.parent
    # Files first: whoever reads the tables may leave before their end.
    page = _write_page(lambda: run_page(reported), folder / PAGE_NAME, output)
    write_json(report.document(), output.json)
    print_report(report, output.console, processes=output.by_agent)
    say(output.console, f"recording: {run}", *page)
    if report.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED


def _time_several(
    rates: Rates, duration: str, request: RunRequest, output: _Output, shown: PageProcess | None
) -> int:
    from launch_scripts.launcher.run_folder import new_run_id, run_folder
    from studies.timing.measured_run import measured_run, prepare_at
    from studies.timing.page import PAGE_NAME, sweep_page
    from studies.timing.sweep import print_sweep, sweep

    folder = run_folder(f"{new_run_id('timing')}-rates", request.out).path
    reports: list[TimingReport] = []

    def prepared(rate_hz: float) -> Callable[[], Reported]:
        preparation, place = prepare_at(rate_hz, duration, request, folder / f"rate-{rate_hz:g}")
        return lambda: measured_run(preparation, place, output.console)

    # All listed rates are prepared before the first one runs, so that none is refused then.
    listed = {rate_hz: prepared(rate_hz) for rate_hz in rates.listed_hz}

    if shown is not None:
        say(output.console, f"page: {shown.show(folder, several=True)}")

    def timed(rate_hz: float) -> TimingReport:
        run = listed.get(rate_hz) or prepared(rate_hz)
        reports.append(run().report)
        return reports[-1]

    found = sweep(rates, timed)
    page: list[str] = []
    if reports:
        page = _write_page(lambda: sweep_page(found, reports[-1]), folder / PAGE_NAME, output)
    write_json(found, output.json)
    print_sweep(found, output.console)
    say(output.console, f"recordings: {folder}", *page)
    if found.interrupted:
        return INTERRUPTED
    return FAILED if found.highest_clean_hz is None else OK


def _write_page(html: Callable[[], str], default: Path, output: _Output) -> list[str]:
    """Write the page if it is wanted; return the line that says where it is."""
    if output.report is None:
        return []
    page = Path(output.report) if output.report else default
    write_page(html(), page)
    return [f"report: {page}"]
