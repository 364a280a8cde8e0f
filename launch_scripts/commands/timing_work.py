"""`heliarch timing`: from the command line's words to tables, JSON, page and exit status."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.commands.delays_work import StudyRequest, run_study
from launch_scripts.commands.termination import Termination, terminable
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.launcher.request import RunRequest
from launch_scripts.launcher.run_folder import new_run_id, run_folder
from launch_scripts.launcher.supervision import RunFailure
from studies.timing.figure_tables import console_for
from studies.timing.measured_run import measured_run, prepare_at, whole_cycles
from studies.timing.page import PAGE_NAME, run_page, sweep_page
from studies.timing.rates import Rates, parse_rates
from studies.timing.report import Reported, TimingReport, report_on
from studies.timing.sweep import Sweep, print_sweep, sweep
from studies.timing.table import print_report
from studies.timing.written_files import concluded, write_files

_RATE: Final = "1"
_DURATION: Final = "60s"
_SWEEP_DURATION: Final = "15s"


@dataclass(frozen=True, slots=True)
class TimingRequest:
    """The words of the command line, None where the user said nothing.

    Attributes
    ----------
    run
        What to run, as for `heliarch launch`.
    scenario
        Which, or a recording; None where the user named none: then a study takes another one than
        a run.
    rate
        Cycles a second: one, several, a range, or `auto`.
    duration
        How long, for each rate.
    processes
        Whether to show each process.
    report
        Whether to write the page.
    """

    run: RunRequest
    scenario: str | None
    rate: str | None
    duration: str | None
    processes: bool
    report: bool


def timing(request: TimingRequest) -> int:
    """Time a plant, or a run that is over; print what it came to. Returns the exit status.

    SIGTERM and SIGHUP end the measurement as Ctrl-C does, and change the exit status.
    """
    console = console_for(request.run.json)
    return _guarded(lambda termination: _time(request, console, termination))


def studied(request: StudyRequest) -> int:
    """Study delay and loss; print what they cost. Returns the exit status."""
    console = console_for(request.json)
    return _guarded(lambda termination: run_study(request, console, termination))


def _guarded(act: Callable[[Termination], int]) -> int:
    """Do what was asked for; say in one line why it could not be done."""
    try:
        with terminable() as termination:
            try:
                return termination.status(act(termination))
            except KeyboardInterrupt:
                return termination.status(complain("interrupted", INTERRUPTED))
    except InputError as error:
        return complain(error, BAD_INPUT)
    except OSError as error:
        return complain(f"{error.filename}: {error.strerror}" if error.filename else error, FAILED)
    except RunFailure as error:
        return complain(error, FAILED)


def _time(request: TimingRequest, console: Console, termination: Termination) -> int:
    recording = _recording(request)
    if recording is not None:
        reported = report_on(recording, by_agent=request.processes)
        return _tell_one(reported, recording, request, console)
    rates = _check(request)
    if rates.single_hz is not None:
        return _time_one(rates.single_hz, request, console, termination)
    return _time_several(rates, request, console, termination)


def _recording(request: TimingRequest) -> Path | None:
    """Return the recording that the user named; None if it is a scenario to run."""
    path = Path(request.scenario or "")
    if not request.scenario or not (path.is_dir() or path.suffix == ".mcap"):
        return None
    check_json_destination(request.run.json)
    run = request.run
    _refuse(
        {
            "--rate": request.rate,
            "--duration": request.duration,
            "--out": run.out,
            **_of_a_run(run),
        },
        f"{path} was run already; expected beside it --processes, --report or --json",
    )
    return path


def _of_a_run(run: RunRequest) -> dict[str, object]:
    return {
        "--start": run.start,
        "--seed": run.seed,
        "--scheme": run.scheme,
        "--actuator": run.actuator,
        "--fault": run.faults,
        "--external": run.external.agents,
        "--base-port": run.external.base_port,
        "--cpus": run.machine.cpus,
        "--priority": run.machine.priority,
    }


def _refuse(options: dict[str, object], why: str) -> None:
    for option, given in options.items():
        if given or given == "":
            raise InputError(f"{option}: {why}")


def _check(request: TimingRequest) -> Rates:
    rates = parse_rates(_RATE if request.rate is None else request.rate)
    check_json_destination(request.run.json)
    for rate_hz in rates.listed_hz or (rates.search_hz or ())[:1]:
        whole_cycles(rate_hz, request.duration or _DURATION)
    return rates


def _time_one(
    rate_hz: float, request: TimingRequest, console: Console, termination: Termination
) -> int:
    duration = request.duration or _DURATION
    preparation, folder = prepare_at(rate_hz, duration, request.run, request.run.out)
    reported = measured_run(preparation, folder, console, by_agent=request.processes)
    with termination.held():
        return _tell_one(reported, folder.path, request, console)


def _tell_one(reported: Reported, run: Path, request: TimingRequest, console: Console) -> int:
    """Write and print what a run came to."""
    report = reported.report
    page = (run if run.is_dir() else run.parent) / PAGE_NAME
    unwritten = write_files(
        request.run.json,
        report.as_json,
        page if request.report else None,
        lambda: run_page(reported),
    )
    print_report(report, console, processes=request.processes)
    _say(console, f"recording: {run}")
    return concluded(exit_status(report), unwritten)


def _time_several(
    rates: Rates, request: TimingRequest, console: Console, termination: Termination
) -> int:
    folder = run_folder(f"{new_run_id('timing')}-rates", request.run.out).path
    duration = request.duration or _SWEEP_DURATION
    reports: list[TimingReport] = []

    def prepared(rate_hz: float) -> Callable[[], Reported]:
        out = folder / f"rate-{rate_hz:g}"
        preparation, place = prepare_at(rate_hz, duration, request.run, out)
        return lambda: measured_run(preparation, place, console)

    # All listed rates are worked out before the first one runs, so that none is refused then.
    listed = {rate_hz: prepared(rate_hz) for rate_hz in rates.listed_hz}

    def timed(rate_hz: float) -> TimingReport:
        run = listed.get(rate_hz) or prepared(rate_hz)
        reports.append(run().report)
        return reports[-1]

    found = sweep(rates, timed)
    with termination.held():
        return _tell_several(found, reports, folder, request, console)


def _tell_several(
    found: Sweep,
    reports: list[TimingReport],
    folder: Path,
    request: TimingRequest,
    console: Console,
) -> int:
    """Write and print what the rates came to."""
    page = folder / PAGE_NAME if request.report and reports else None
    unwritten = write_files(
        request.run.json, found.as_json, page, lambda: sweep_page(found, reports[-1])
    )
    print_sweep(found, console)
    _say(console, f"recordings: {folder}")
    status = FAILED if found.highest_clean_hz is None else OK
    return concluded(INTERRUPTED if found.interrupted else status, unwritten)


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True, markup=False)


def exit_status(report: TimingReport) -> int:
    """Return what the run means to a script: kept, not kept, or interrupted."""
    if report.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED
