"""`heliarch timing`: from the command line's words to tables, JSON, page and exit status."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.json_rows import check_json_destination
from launch_scripts.lasting_console import LastingConsole, write_if_read
from launch_scripts.run_command import RunRequest
from launch_scripts.run_folder import new_run_id, run_folder
from launch_scripts.supervision import RunFailure
from launch_scripts.termination import Termination, terminable
from launch_scripts.timing.delay_study_command import StudyRequest, run_study
from launch_scripts.timing.figure_tables import WIDTH
from launch_scripts.timing.lasting_files import write_or_tell
from launch_scripts.timing.measured_run import (
    MeasuredRun,
    measured_run,
    prepare_at,
    whole_cycles,
)
from launch_scripts.timing.rates import Rates, parse_rates
from launch_scripts.timing.sweep import Sweep, print_sweep, sweep
from launch_scripts.timing.timing_page import PAGE_NAME, write_page, write_sweep_page
from launch_scripts.timing.timing_report import TimingReport, report_on
from launch_scripts.timing.timing_table import print_report
from launch_scripts.timing.trials import Trials

STUDY_PAGE_NAME: Final = "delay-study.html"

_RATE: Final = "1"
_DURATION: Final = "60s"
_SWEEP_DURATION: Final = "15s"
_STUDY_WORKERS: Final = 2


@dataclass(frozen=True, slots=True)
class TimingRequest:
    """The words of the command line, None where the user said nothing.

    Attributes
    ----------
    run
        What to run, as for `heliarch launch`.
    scenario
        Which, None where the user named none: then a study takes another one than a run.
    rate
        Cycles a second: one, several, a range, or `auto`.
    duration
        How long, for each rate.
    processes
        Whether to show each process.
    report
        Whether to write the page.
    study, settings, workers
        Whether to study delay and loss in memory instead, and what is for that alone: fields of
        the scenario to change, and how many processes share the work.
    """

    run: RunRequest
    scenario: str | None
    rate: str | None
    duration: str | None
    processes: bool
    report: bool
    study: bool = False
    settings: tuple[str, ...] = ()
    workers: int | None = None


def timing(request: TimingRequest) -> int:
    """Time a plant; print what it came to. Returns the exit status.

    SIGTERM and SIGHUP end the measurement as Ctrl-C does, and change the exit status. Of a study
    that is ended so nothing is printed.
    """
    # With the JSON on standard output, nothing else may go there.
    to_stdout = request.run.json == "-"
    console = LastingConsole(stderr=to_stdout)
    if not console.is_terminal:
        console = LastingConsole(stderr=to_stdout, width=WIDTH)
    try:
        if request.study:
            return run_study(_study(request))
        rates = _check(request)
        with terminable() as termination:
            return termination.status(_time(rates, request, console, termination))
    except InputError as error:
        return complain(error, BAD_INPUT)
    except OSError as error:
        named = f"{error.filename}: {error.strerror}" if error.filename else error
        return complain(named, FAILED)
    except RunFailure as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


def _time(
    rates: Rates, request: TimingRequest, console: LastingConsole, termination: Termination
) -> int:
    """Measure; print and write what it came to, at the end and when it is interrupted."""
    try:
        if rates.single_hz is not None:
            return _time_one(rates.single_hz, request, console, termination)
        return _time_several(rates, request, console, termination)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


def _study(request: TimingRequest) -> StudyRequest:
    """Return the study that was asked for; refuse what would be lost on it."""
    run = request.run
    lost: dict[str, object] = {
        "--rate": request.rate,
        "--scheme": run.scheme,
        "--actuator": run.actuator,
        "--fault": run.faults,
        "--external": run.external.agents,
        "--base-port": run.external.base_port,
        "--cpus": run.machine.cpus,
        "--priority": run.machine.priority,
        "--processes": request.processes,
    }
    for option, given in lost.items():
        if given or given == "":
            raise InputError(
                f"{option}: a study runs in memory, each scheme with delays and losses of its own; "
                "accepted beside --study are --start, --duration, --seed, --set, --data, "
                "--workers, --report, --out and --json"
            )
    page = (run.out or Path()) / STUDY_PAGE_NAME if request.report else None
    return StudyRequest(
        request.scenario,
        run.start,
        request.duration,
        run.seed,
        request.settings,
        run.data,
        _STUDY_WORKERS if request.workers is None else request.workers,
        run.json,
        page,
    )


def _check(request: TimingRequest) -> Rates:
    if request.settings or request.workers is not None:
        option = "--set" if request.settings else "--workers"
        raise InputError(f"{option}: it is for a study, accepted is with --study")
    rates = parse_rates(_RATE if request.rate is None else request.rate)
    check_json_destination(request.run.json)
    for rate_hz in rates.listed_hz or (rates.search_hz or ())[:1]:
        whole_cycles(rate_hz, request.duration or _DURATION)
    return rates


def _time_one(
    rate_hz: float, request: TimingRequest, console: LastingConsole, termination: Termination
) -> int:
    duration = request.duration or _DURATION
    preparation, place = prepare_at(rate_hz, duration, request.run, request.run.out)
    try:
        run = measured_run(preparation, place, console)
    except KeyboardInterrupt:
        return complain("interrupted; the processes were ended by force", INTERRUPTED)
    with termination.held():
        return _tell_one(run, request, console)


def _tell_one(run: MeasuredRun, request: TimingRequest, console: LastingConsole) -> int:
    """Print and write what a run came to. A file that cannot be written costs no other."""
    report, slowest = report_on(run)
    print_report(report, console, processes=request.processes)
    _say(console, f"recording: {run.recording}")
    unwritten = [run.unwritten, _write_json(report.as_json(), request.run.json)]
    if request.report:
        path = run.recording.with_name(PAGE_NAME)
        unwritten.append(_write_page(partial(write_page, path, report, slowest, run.plan.tree)))
        if not unwritten[-1]:
            _say(console, f"page: {path}")
    return _after_writing(exit_status(report), unwritten, console)


def _time_several(
    rates: Rates, request: TimingRequest, console: LastingConsole, termination: Termination
) -> int:
    folder = run_folder(f"{new_run_id('timing')}-rates", request.run.out).path
    duration = request.duration or _SWEEP_DURATION
    trials = Trials(request.run, duration, folder, console, termination)
    trials.prepare(rates.listed_hz)
    found = sweep(rates, trials.run)
    with termination.held():
        return _tell_several(found, trials, folder, request, console)


def _tell_several(
    found: Sweep, trials: Trials, folder: Path, request: TimingRequest, console: LastingConsole
) -> int:
    """Print and write what the rates came to. A file that cannot be written costs no other."""
    print_sweep(found, console)
    _say(console, f"recordings: {folder}")
    unwritten = [*trials.unwritten, _write_json(found.as_json(), request.run.json)]
    if request.report and trials.latest is not None:
        path = folder / PAGE_NAME
        unwritten.append(_write_page(partial(write_sweep_page, path, found, trials.latest)))
        if not unwritten[-1]:
            _say(console, f"page: {path}")
    status = FAILED if found.highest_clean_hz is None else OK
    return _after_writing(INTERRUPTED if found.interrupted else status, unwritten, console)


def _after_writing(status: int, unwritten: Iterable[str], console: LastingConsole) -> int:
    """Return the exit status: a measurement of which something was not written is no success."""
    told = list(filter(None, unwritten))
    for text in told:
        complain(f"not written: {text}", FAILED)
    return FAILED if status == OK and (told or console.lost) else status


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True, markup=False)


def exit_status(report: TimingReport) -> int:
    """Return what the run means to a script: kept, not kept, or interrupted."""
    if report.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED


def _write_json(document: bytes, json: str | None) -> str:
    """Write a document; tell why it could not be written, nothing if it was."""
    if json is None:
        return ""
    if json == "-":
        return write_if_read(document.decode() + "\n")
    return write_or_tell(Path(json), document + b"\n")


def _write_page(write: Callable[[], None]) -> str:
    """Write a page; tell why it could not be written, nothing if it was."""
    try:
        write()
    except (InputError, OSError) as error:
        return str(error)
    return ""
