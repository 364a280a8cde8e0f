"""`heliarch timing --study`: how much delay and loss the control survives."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bus_schemas.errors import InputError
from launch_scripts.commands.termination import Termination
from launch_scripts.exit_status import FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario, parse_duration_s
from studies.compare.cases import cases, parse_setting
from studies.compare.study import remarks_of
from studies.delays.page import study_page
from studies.delays.study import (
    WARM_UP_S,
    Outcome,
    conditions,
    run_study_over,
)
from studies.delays.table import counted_s, print_study
from studies.timing.written_files import concluded, write_files

DEFAULT_SCENARIO: Final = "oahu-day"
DEFAULT_START: Final = "11:58"
DEFAULT_DURATION: Final = "62m"
DEFAULT_SETTINGS: Final = ("commitment.share=0.6",)
"""At the scenario's own share, 0.8, the clouds take more than control ever could."""

_MOST_WORKERS: Final = 256


@dataclass(frozen=True, slots=True)
class StudyRequest:
    """The words of the command line, None where the user said nothing.

    Without a scenario it is the hour from noon of `oahu-day`, with a commitment of 0.6 of what is
    possible. `page` is the HTML page to write.
    """

    scenario: str | None = None
    start: str | None = None
    duration: str | None = None
    seed: int | None = None
    settings: tuple[str, ...] = ()
    data: Path | None = None
    workers: int = 2
    json: str | None = None
    page: Path | None = None


class _StudyDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The study for machines."""

    scenario: str
    start: str
    cycles: int
    cycle_s: float
    settings: tuple[str, ...]
    remarks: tuple[str, ...]
    outcomes: tuple[Outcome, ...]


def run_study(request: StudyRequest, console: Console, termination: Termination) -> int:
    """Run the study that was asked for and print its tables. Returns the exit status.

    Raises
    ------
    InputError
        It cannot be.
    """
    request, preparation = _prepared(request)
    try:
        outcomes = _run(preparation, request.workers, console)
    except BrokenProcessPool:
        if termination.number is not None:  # `timeout` sends its signal to the workers, too.
            return complain("interrupted", INTERRUPTED)
        return complain("a worker was killed, often for a lack of memory: fewer --workers", FAILED)
    with termination.held():
        unwritten = write_files(
            request.json,
            lambda: _document(request, preparation, outcomes),
            request.page,
            lambda: study_page(preparation, outcomes),
        )
        print_study(preparation, outcomes, console)
    return concluded(OK, unwritten)


def _prepared(request: StudyRequest) -> tuple[StudyRequest, Preparation]:
    try:
        request = _with_defaults(request)
        return request, _prepare(request)
    except OSError as error:
        # A file that may not be read, or a name that no file can have.
        raise InputError(str(error)) from None


def _with_defaults(request: StudyRequest) -> StudyRequest:
    if not 1 <= request.workers <= _MOST_WORKERS:
        raise InputError(f"--workers {request.workers}: accepted are 1 to {_MOST_WORKERS}")
    if request.duration is not None:
        _check_duration(request.duration)
    check_json_destination(request.json)
    if request.page is not None:
        _check_page(request.page)
    if request.scenario is not None:
        return request
    return StudyRequest(
        DEFAULT_SCENARIO,
        request.start or DEFAULT_START,
        request.duration or DEFAULT_DURATION,
        request.seed,
        DEFAULT_SETTINGS + request.settings,
        request.data,
        request.workers,
        request.json,
        request.page,
    )


def _check_duration(duration: str) -> None:
    """Refuse a study of which nothing would count, before its weather is worked out."""
    if parse_duration_s(duration, "--duration") <= WARM_UP_S:
        raise InputError(
            f"--duration {duration}: accepted for a study is more than the {WARM_UP_S:g} s at the "
            "beginning of each run that do not count"
        )


def _check_page(path: Path) -> None:
    """Refuse a place where no page can be written; folders that are not there are made later."""
    existing = next(folder for folder in path.absolute().parents if folder.exists())
    if path.is_dir() or not existing.is_dir():
        raise InputError(f"report {path}: accepted is a file in a folder, {existing} is none")


def _prepare(request: StudyRequest) -> Preparation:
    settings = [parse_setting(text) for text in request.settings]
    for setting, text in zip(settings, request.settings, strict=True):
        if len(setting.values) > 1:
            raise InputError(f"--set {text}: accepted is one value for a study")
    (case,) = cases(
        load_scenario(request.scenario or DEFAULT_SCENARIO, request.data),
        RunOptions(request.start, request.duration, seed=request.seed),
        settings,
    )
    preparation = prepare(case.scenario, case.options, "study")
    if preparation.plan.faults:
        raise InputError(
            f"{case.scenario.path}: faults, accepted for a study is a scenario without: it brings "
            "its own"
        )
    if preparation.plan.cycles * preparation.plan.cycle_ns <= WARM_UP_S * 1e9:
        raise InputError(
            f"a run of {preparation.plan.cycles:,} cycles, accepted for a study is one of more "
            f"than the {WARM_UP_S:g} s that do not count"
        )
    return preparation


def _run(preparation: Preparation, workers: int, console: Console) -> list[Outcome]:
    plan = preparation.plan
    correction = preparation.scenario.scenario.control.correction
    chosen = conditions(plan.cycle_ns / 1e9, counted_s(preparation), correction)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    found: dict[int, Outcome] = {}
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("runs", total=len(chosen))
        for number, outcome in run_study_over(plan, preparation.profile, chosen, workers):
            found[number] = outcome
            progress.advance(task)
    return [found[number] for number in sorted(found)]


def _document(
    request: StudyRequest, preparation: Preparation, outcomes: Sequence[Outcome]
) -> bytes:
    plan = preparation.plan
    document = _StudyDocument(
        scenario=plan.plant,
        start=preparation.local_start(),
        cycles=plan.cycles,
        cycle_s=plan.cycle_ns / 1e9,
        settings=request.settings,
        remarks=remarks_of(preparation),
        outcomes=tuple(outcomes),
    )
    return msgspec.json.format(msgspec.json.encode(document), indent=1)
