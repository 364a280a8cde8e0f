"""`heliarch compare`: control schemes side by side, on one day or on many."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bus_schemas.errors import InputError
from launch_scripts.exit_status import BAD_INPUT, FAILED, INTERRUPTED, OK, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.read.series import RunSeries
from recordings.read.whole_file import whole_file
from studies.arrays.schemes import DEFAULT_SCHEMES, SCHEMES, ReferenceGroups
from studies.compare.cases import Case, cases, parse_days, parse_seeds, parse_setting
from studies.compare.study import (
    CaseResult,
    Comparison,
    SchemeResult,
    WorkerLost,
    remarks_of,
    results_of,
    run_cases,
)
from studies.compare.tables import (
    FIGURES,
    commitment_table,
    pivot_table,
    regulation_table,
    rows,
    summary_table,
)
from studies.report.metrics_tables import metrics_tables
from studies.report.run_report import check_destination, write_report

_LISTED: Final = 40
"""Up to so many cases each has its row; of more, the mean and the extremes are shown."""

_MOST_WORKERS: Final = 256
_PIPE_WIDTH: Final = 120


@dataclass(frozen=True, slots=True)
class CompareRequest:
    """The words of the command line, None where the user said nothing."""

    scenario: str
    start: str | None
    duration: str | None
    days: str | None
    seeds: str | None
    settings: Sequence[str]
    schemes: str | None
    reference: str | None
    show: str
    agents: bool
    workers: int
    scheduler: str | None
    data: Path | None
    report: Path | None
    json: str | None


def compare(request: CompareRequest) -> int:
    """Compare what was asked for and print the tables. Returns the exit status."""
    console = _console(to_stderr=request.json == "-")
    try:
        comparison, found = _plan(request)
        if len(found) == 1:
            results = [_one(found[0], comparison, request.report, console)]
        else:
            results = _many(found, comparison, request, console)
        _write_rows(results, request.json)
    except (InputError, OSError) as error:
        return complain(error, BAD_INPUT)
    except WorkerLost as error:
        return complain(error, FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    return OK


def _console(*, to_stderr: bool) -> Console:
    """Return a console on which the tables keep their columns, also in a pipe."""
    console = Console(stderr=to_stderr)
    return console if console.is_terminal else Console(stderr=to_stderr, width=_PIPE_WIDTH)


def _plan(request: CompareRequest) -> tuple[Comparison, list[Case]]:
    if request.show not in FIGURES:
        raise InputError(f"--show {request.show}: accepted are {', '.join(FIGURES)}")
    if not 1 <= request.workers <= _MOST_WORKERS:
        raise InputError(f"--workers {request.workers}: accepted are 1 to {_MOST_WORKERS}")
    check_json_destination(request.json)
    if request.report is not None:
        check_destination(request.report)
    found = cases(
        load_scenario(request.scenario, request.data),
        RunOptions(request.start, request.duration),
        [parse_setting(text) for text in request.settings],
        parse_days(request.days) if request.days else (),
        parse_seeds(request.seeds) if request.seeds else (),
    )
    if request.scheduler is not None and len(found) == 1:
        raise InputError("--scheduler: accepted with more than one case, there is one")
    if request.report is not None and len(found) > 1:
        raise InputError(f"--report: accepted with one case, the study has {len(found):,}")
    return Comparison(_schemes(request.schemes), _groups(request.reference), request.agents), found


def _schemes(text: str | None) -> tuple[str, ...]:
    if text is None:
        return DEFAULT_SCHEMES
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in SCHEMES:
            raise InputError(f"--schemes {name}: accepted are {', '.join(SCHEMES)}")
    return names


def _groups(text: str | None) -> ReferenceGroups:
    if text is None:
        return ReferenceGroups()
    words = tuple(word.strip() for word in text.split(","))
    if not all(words):
        raise InputError(f"--reference {text!r}: accepted are sizes (1,4,8) or inverters")
    if all(word.isdecimal() for word in words):
        return ReferenceGroups(sizes=tuple(int(word) for word in words))
    return ReferenceGroups(members=words)


def _one(case: Case, comparison: Comparison, report: Path | None, console: Console) -> CaseResult:
    """Run one case and print the paper's tables; write a report of it if asked for."""
    preparation = prepare(case.scenario, case.options, "compare")
    for line in remarks_of(preparation):
        console.print(line, highlight=False)
    found = list(results_of(preparation, comparison))
    schemes = tuple(SchemeResult(label, metrics) for label, metrics, _ in found)
    title = f"{preparation.plan.plant} from {preparation.local_start()}, {_length(preparation)}"
    console.print(commitment_table(title, schemes))
    regulation = regulation_table(schemes)
    if regulation is not None:
        console.print(regulation)
    if report is not None:
        _write_report(report, title, [series for _, _, series in found], preparation)
        console.print(f"report: {report}", highlight=False, soft_wrap=True)
    return CaseResult(case.label, schemes, 0.0, 0.0, remarks_of(preparation))


def _length(preparation: Preparation) -> str:
    plan = preparation.plan
    return f"{plan.cycles:,} cycles of {plan.cycle_ns / 1e9:g} s, actuator {plan.actuator}"


def _write_report(
    path: Path, title: str, series: Sequence[RunSeries], preparation: Preparation
) -> None:
    notes = [f"Scenario: {preparation.scenario.scenario.title}.", *remarks_of(preparation)]
    write_report(path, title, series, metrics_tables(series), notes)


def _many(
    found: Sequence[Case], comparison: Comparison, request: CompareRequest, console: Console
) -> list[CaseResult]:
    """Run many cases with a progress bar and print one figure of them."""
    results: dict[int, CaseResult] = {}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("cases", total=len(found))
        for number, result in run_cases(
            found, comparison, workers=request.workers, scheduler=request.scheduler
        ):
            results[number] = result
            progress.advance(task)
    ordered = [results[number] for number in sorted(results)]
    for line in dict.fromkeys(line for result in ordered for line in result.remarks):
        console.print(line, highlight=False)
    table = pivot_table if len(ordered) <= _LISTED else summary_table
    console.print(table(request.show, ordered))
    prepare_s = sum(result.prepare_s for result in ordered)
    run_s = sum(result.run_s for result in ordered)
    console.print(
        f"sky and market took {prepare_s:.1f} s, the schemes and their figures {run_s:.1f} s, "
        "added up over all cases",
        highlight=False,
    )
    return ordered


def _write_rows(results: Sequence[CaseResult], json: str | None) -> None:
    if json is None:
        return
    document = msgspec.json.format(msgspec.json.encode(rows(results)), indent=1)
    if json == "-":
        sys.stdout.write(document.decode() + "\n")
        return
    with whole_file(Path(json)) as file:
        file.write(document + b"\n")
