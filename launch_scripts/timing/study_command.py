"""`heliarch timing --study`: how much delay and loss the control survives."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Final, get_args

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from agents.plan import Scheme
from bus_schemas.errors import InputError
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import load_scenario, parse_duration_s
from launch_scripts.study.cases import cases, parse_setting
from launch_scripts.study.compare_command import check_json_path
from launch_scripts.study.study import remarks_of
from launch_scripts.timing.delay_study import (
    VALUES,
    WARM_UP_S,
    Outcome,
    Trouble,
    conditions,
    run_study_over,
)
from recordings.report.delay_figures import StudyCurve, study_figure
from recordings.report.page import html_page
from recordings.report.run_report import write_whole
from recordings.report.tables import ReportTable

DEFAULT_SCENARIO: Final = "oahu-day"
DEFAULT_START: Final = "11:58"
DEFAULT_DURATION: Final = "62m"
DEFAULT_SETTINGS: Final = ("commitment.share=0.6",)
"""At the scenario's own share, 0.8, the clouds take more than control ever could."""

BEARABLE_PERCENT: Final = 1.0
"""Control-caused shortfall, in % of desired, up to which a trouble counts as survived."""

_MOST_WORKERS: Final = 256
_PIPE_WIDTH: Final = 120

_TROUBLES: Final[dict[Trouble, tuple[str, str]]] = {
    "delay": ("every hop delayed", "delay of each hop [s]"),
    "loss": ("a share of all messages lost", "lost messages [%]"),
    "period": ("a slow central controller", "central period [s]"),
}

_MERITS: Final[dict[str, Callable[[Outcome], float | None]]] = {
    "control-caused [%]": lambda one: one.control_caused_percent,
    "over-delivered [%]": lambda one: one.over_delivered_percent,
    "mileage [kW/h]": lambda one: one.mileage_kw_per_h,
    "RegD fulfilled [%]": lambda one: one.fulfilled_percent,
    "PJM score": lambda one: one.score,
}
_DRAWN: Final = ("control-caused [%]", "mileage [kW/h]", "RegD fulfilled [%]", "PJM score")

_LEGEND: Final = (
    "control-caused, over-delivered: in % of the desired energy; RegD: requests fulfilled to 1 % "
    "of the rating; absent: inputs that were not there at their deadline, in % of all",
    "use: a late message stands in for the next one that does not come in time; drop: it does not "
    "(control.late of the scenario)",
    f"the first {WARM_UP_S:g} s of each run do not count",
)
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; all else is perfect. Late messages are used; where they are dropped instead, see the "
    "table."
)


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


def run_study(request: StudyRequest) -> int:
    """Run the study that was asked for and print its tables. Returns the exit status."""
    console = Console(stderr=request.json == "-")
    if not console.is_terminal:
        console = Console(stderr=request.json == "-", width=_PIPE_WIDTH)
    try:
        request = _with_defaults(request)
        preparation = _prepare(request)
        outcomes = _run(preparation, request.workers, console)
        _print(preparation, outcomes, console)
        _write(request, preparation, outcomes, console)
    except (InputError, OSError) as error:
        return _complain(error, 2)
    except BrokenProcessPool:
        return _complain("a worker was killed, often for a lack of memory: fewer --workers", 1)
    except KeyboardInterrupt:
        return _complain("interrupted", 130)
    return 0


def _complain(error: object, status: int) -> int:
    sys.stderr.write(f"heliarch: {error}\n")
    return status


def _with_defaults(request: StudyRequest) -> StudyRequest:
    if not 1 <= request.workers <= _MOST_WORKERS:
        raise InputError(f"--workers {request.workers}: accepted are 1 to {_MOST_WORKERS}")
    if request.duration is not None:
        _check_duration(request.duration)
    if request.json not in (None, "-"):
        check_json_path(Path(request.json))
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
    chosen = conditions(plan.cycle_ns / 1e9, _counted_s(preparation))
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


def _counted_s(preparation: Preparation) -> float:
    plan = preparation.plan
    return plan.cycles * plan.cycle_ns / 1e9 - WARM_UP_S


def _notes(preparation: Preparation) -> tuple[str, ...]:
    """Say what is to be known besides the tables."""
    longest_s = _counted_s(preparation) / 2.0
    too_long = (
        f"central periods above {longest_s:g} s are left out: of each run {2.0 * longest_s:g} s "
        "count, which do not hold two of them",
    )
    shorter = longest_s < max(VALUES.get("period", (0.0,)))
    return (*remarks_of(preparation), *_LEGEND, *(too_long if shorter else ()))


def _title(preparation: Preparation) -> str:
    plan = preparation.plan
    length = f"{plan.cycles:,} cycles of {plan.cycle_ns / 1e9:g} s"
    return f"{plan.plant} from {preparation.local_start()}, {length}"


def _print(preparation: Preparation, outcomes: Sequence[Outcome], console: Console) -> None:
    for line in (_title(preparation), *_notes(preparation)):
        console.print(line, highlight=False)
    for trouble in VALUES:
        console.print(_table(trouble, outcomes))
    for line in survived(outcomes):
        console.print(line, highlight=False)


def _table(trouble: Trouble, outcomes: Sequence[Outcome]) -> Table:
    what, unit = _TROUBLES[trouble]
    table = Table(title=what, title_justify="left")
    table.add_column(unit, justify="right")
    table.add_column("scheme")
    table.add_column("late")
    for heading in (*_MERITS, "absent [%]", "late used"):
        table.add_column(heading.replace("-", "-\n").replace(" ", "\n"), justify="right")
    last = None
    for one in outcomes:
        if one.trouble != trouble:
            continue
        if last not in (None, one.value):
            table.add_section()
        table.add_row("" if one.value == last else f"{one.value:g}", *_cells(one))
        last = one.value
    return table


def _cells(one: Outcome) -> tuple[str, ...]:
    merits = (_text(name, read(one)) for name, read in _MERITS.items())
    return (one.scheme, one.late, *merits, f"{one.missed_percent:.1f}", f"{one.late_used:,}")


def _text(merit: str, value: float | None) -> str:
    if value is None:
        return "-"
    decimals = {"mileage [kW/h]": 0, "RegD fulfilled [%]": 1}.get(merit, 3)
    return f"{value:,.{decimals}f}"


def survived(outcomes: Sequence[Outcome]) -> list[str]:
    """Say, for each scheme, up to where each trouble costs less than 1 % of the desired energy."""
    lines = []
    for scheme in get_args(Scheme):
        parts = []
        for trouble, (_, unit) in _TROUBLES.items():
            column = [
                one
                for one in outcomes
                if (one.trouble, one.scheme, one.late) == (trouble, scheme, "use")
            ]
            borne = [one.value for one in takewhile(_is_bearable, column)]
            name, _, in_unit = unit.partition(" [")
            parts.append(f"{name} up to {borne[-1]:g} {in_unit[:-1]}" if borne else f"no {name}")
        lines.append(
            f"{scheme}: control causes less than {BEARABLE_PERCENT:g} % of shortfall at "
            + ", ".join(parts)
        )
    return lines


def _is_bearable(one: Outcome) -> bool:
    return one.control_caused_percent is not None and one.control_caused_percent < BEARABLE_PERCENT


def _write(
    request: StudyRequest, preparation: Preparation, outcomes: Sequence[Outcome], console: Console
) -> None:
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
    text = msgspec.json.format(msgspec.json.encode(document), indent=1).decode() + "\n"
    if request.json == "-":
        sys.stdout.write(text)
    elif request.json is not None:
        write_whole(Path(request.json), text)
    if request.page is not None:
        request.page.parent.mkdir(parents=True, exist_ok=True)
        write_whole(request.page, _page(preparation, outcomes))
        console.print(f"page: {request.page}", highlight=False, soft_wrap=True, markup=False)


def _page(preparation: Preparation, outcomes: Sequence[Outcome]) -> str:
    title = f"{_title(preparation)}: delay, loss and a slow central controller"
    figure = study_figure("study", "What each trouble costs", _CAPTION, _curves(outcomes))
    notes = [*_notes(preparation), *survived(outcomes)]
    tables = [_page_table(trouble, outcomes) for trouble in VALUES]
    return html_page(title, notes, tables, [figure])


def _curves(outcomes: Sequence[Outcome]) -> list[StudyCurve]:
    curves = []
    for merit in _DRAWN:
        for trouble, (_, unit) in _TROUBLES.items():
            for scheme in get_args(Scheme):
                column = [
                    one
                    for one in outcomes
                    if (one.trouble, one.scheme, one.late) == (trouble, scheme, "use")
                ]
                merits = [_MERITS[merit](one) for one in column]
                curves.append(
                    StudyCurve(merit, unit, scheme, [one.value for one in column], merits)
                )
    return curves


def _page_table(trouble: Trouble, outcomes: Sequence[Outcome]) -> ReportTable:
    what, unit = _TROUBLES[trouble]
    rows = tuple(
        (f"{one.value:g}, {one.scheme}, late: {one.late}", "", _cells(one)[2:])
        for one in outcomes
        if one.trouble == trouble
    )
    columns = (*_MERITS, "absent [%]", "late used")
    return ReportTable(f"{what[0].upper()}{what[1:]}", columns, rows, f"First column: {unit}.")
