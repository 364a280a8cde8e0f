"""`heliarch timing`: from the command line's words to tables, JSON, page and exit status."""

from __future__ import annotations

from dataclasses import dataclass
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
from launch_scripts.timing.delay_study_command import StudyRequest, run_study
from launch_scripts.timing.measured_run import measured_run, prepare_at, whole_cycles
from launch_scripts.timing.rates import Rates, parse_rates
from launch_scripts.timing.sweep import print_sweep, sweep
from launch_scripts.timing.timing_page import PAGE_NAME, write_page, write_sweep_page
from launch_scripts.timing.timing_report import TimingReport, report_on
from launch_scripts.timing.timing_table import WIDTH, print_report
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
    """Time a plant; print what it came to. Returns the exit status."""
    # With the JSON on standard output, nothing else may go there.
    to_stdout = request.run.json == "-"
    console = LastingConsole(stderr=to_stdout)
    if not console.is_terminal:
        console = LastingConsole(stderr=to_stdout, width=WIDTH)
    try:
        if request.study:
            return run_study(_study(request))
        rates = _check(request)
        if rates.single_hz is not None:
            return _time_one(rates.single_hz, request, console)
        return _time_several(rates, request, console)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except (OSError, RunFailure) as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted; the processes were ended by force", INTERRUPTED)


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


def _time_one(rate_hz: float, request: TimingRequest, console: Console) -> int:
    duration = request.duration or _DURATION
    preparation, place = prepare_at(rate_hz, duration, request.run, request.run.out)
    run = measured_run(preparation, place, console)
    report, slowest = report_on(run)
    print_report(report, console, processes=request.processes)
    _say(console, f"recording: {run.recording}")
    _write_json(report.as_json(), request.run.json)
    if request.report:
        path = run.recording.with_name(PAGE_NAME)
        write_page(path, report, slowest, run.plan.tree)
        _say(console, f"page: {path}")
    return exit_status(report)


def _time_several(rates: Rates, request: TimingRequest, console: Console) -> int:
    folder = run_folder(f"{new_run_id('timing')}-rates", request.run.out).path
    duration = request.duration or _SWEEP_DURATION
    trials = Trials(request.run, duration, folder, console)
    trials.prepare(rates.listed_hz)
    found = sweep(rates, trials.run)
    print_sweep(found, console)
    _say(console, f"recordings: {folder}")
    _write_json(found.as_json(), request.run.json)
    if request.report and trials.latest is not None:
        write_sweep_page(folder / PAGE_NAME, found, trials.latest)
        _say(console, f"page: {folder / PAGE_NAME}")
    if found.interrupted:
        return INTERRUPTED
    return FAILED if found.highest_clean_hz is None else OK


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, soft_wrap=True, markup=False)


def exit_status(report: TimingReport) -> int:
    """Return what the run means to a script: kept, not kept, or interrupted."""
    if report.interrupted:
        return INTERRUPTED
    return OK if report.passed else FAILED


def _write_json(document: bytes, json: str | None) -> None:
    if json == "-":
        write_if_read(document.decode() + "\n")
    elif json is not None:
        Path(json).write_bytes(document + b"\n")
