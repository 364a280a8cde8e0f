"""`heliarch compare`: control schemes side by side, on one day or on many."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    EndOption,
    JsonOption,
    ReportOption,
    ScenarioArgument,
    StartOption,
    WorkersOption,
)
from launch_scripts.commands.output import counted, say, write_json
from studies.tables import console_for, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from studies.arrays.schemes import ReferenceGroups
    from studies.compare.cases import Case
    from studies.compare.study import CaseResult, Comparison

EXAMPLE: Final = "heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10"
PAGE_NAME: Final = "compare.html"


def compare(
    scenario: ScenarioArgument = "oahu-day",
    start: StartOption = None,
    end: EndOption = None,
    duration: DurationOption = None,
    days: Annotated[
        str | None,
        typer.Option(help="Dates, such as 2010-04-01..2010-04-30.", metavar="DATES"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds of synthetic clouds, such as 1..5,9.", metavar="SEEDS")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A field of the scenario and its values; each combination is a case.",
            metavar="FIELD=VALUES",
        ),
    ] = None,
    schemes: Annotated[
        str | None,
        typer.Option(
            help="Control schemes, with commas: uncontrolled, uniform-cap, grouping, paper, "
            "predictive, physical-limit. Default all.",
            metavar="NAMES",
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Reference groups of grouping control: sizes (1,4,8), or inverters (inv01,inv07).",
            metavar="GROUPS",
        ),
    ] = None,
    show: Annotated[
        str,
        typer.Option(
            help="Figure of merit to show for many cases: desired-energy, possible-energy, "
            "delivered-energy, satisfied, shortfall-energy, unavoidable-energy, "
            "control-caused-energy, over-delivered-energy, shortfall, unavoidable, "
            "control-caused, over-delivered, rmse, mae, mileage-total, mileage, "
            "mileage-per-minute, headroom, mean-headroom, ancillary-potential, rise, fall, "
            "ramp, ramp-limit, above-ramp-limit, capacity, offered, signal-mileage, "
            "regd-strict, regd, accuracy, delay, precision, score.",
            metavar="FIGURE",
        ),
    ] = "control-caused",
    workers: WorkersOption = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler that shares the cases.", metavar="ADDRESS")
    ] = None,
    data: DataOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Put control schemes side by side: the paper's tables, for one day or many.

    With a single case, --report writes a page, compare.html by default.
    """
    from launch_scripts.scenarios.preparation import RunOptions
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import cases, parse_days, parse_seeds, parse_setting
    from studies.compare.study import Comparison
    from studies.compare.tables import json_rows
    from studies.metrics.figures_of_merit import FIGURES_OF_MERIT

    if show not in FIGURES_OF_MERIT:
        raise InputError(f"--show: expected one of {', '.join(FIGURES_OF_MERIT)}, got {show}")
    found = cases(
        load_scenario(scenario, data),
        RunOptions(start, duration, end=end),
        [parse_setting(text) for text in settings or ()],
        parse_days(days) if days else (),
        parse_seeds(seeds) if seeds else (),
    )
    if scheduler is not None and len(found) == 1:
        raise InputError("--scheduler: expected more than one case, got one")
    if report is not None and len(found) > 1:
        raise InputError(f"--report: expected one case, got {len(found):,}")
    comparison = Comparison(chosen_schemes(schemes), _groups(reference))
    console = console_for(json)
    if len(found) == 1:
        page = None if report is None else Path(report or PAGE_NAME)
        _one(found[0], comparison, page, json, console)
    else:
        results = _many(found, comparison, workers, scheduler, console)
        # The file first: whoever reads the table may leave before its end.
        write_json(json_rows(results), json)
        _print_many(results, show, console)


def chosen_schemes(text: str | None) -> tuple[str, ...]:
    """Return the schemes of a text with commas; of None all."""
    from studies.arrays.schemes import SCHEMES

    if text is None:
        return tuple(SCHEMES)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in SCHEMES:
            raise InputError(f"--schemes: expected {', '.join(SCHEMES)}, got {name}")
    return names


def _groups(text: str | None) -> ReferenceGroups:
    from studies.arrays.schemes import ReferenceGroups

    if text is None:
        return ReferenceGroups()
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f"--reference: expected sizes (1,4,8) or inverters, got {text!r}")
    if all(name.isdecimal() for name in names):
        return ReferenceGroups(sizes=tuple(int(name) for name in names))
    return ReferenceGroups(members=names)


def _one(
    case: Case, comparison: Comparison, page: Path | None, json: str | None, console: Console
) -> None:
    """Run one case and print the paper's tables; write a page and JSON of it if asked for."""
    from launch_scripts.scenarios.preparation import prepare
    from studies.compare.study import CaseResult, SchemeResult, remarks_of, results_of
    from studies.compare.tables import case_tables, json_rows
    from studies.report.run_report import write_report
    from studies.report.tables import metrics_tables

    preparation = prepare(case.scenario, case.options, "compare")
    remarks = remarks_of(preparation)
    found = list(results_of(preparation, comparison))
    schemes = tuple(SchemeResult(label, metrics) for label, metrics, _ in found)
    plan = preparation.plan
    title = (
        f"{plan.plant} from {preparation.local_start()}, {plan.cycles:,} cycles of "
        f"{plan.cycle_ns / 1e9:g} s, actuator {plan.actuator}"
    )
    write_json(json_rows([CaseResult(case.label, schemes, 0.0, 0.0, remarks)]), json)
    if page is not None:
        notes = [f"Scenario: {preparation.scenario.scenario.title}.", *remarks]
        series = [one for _, _, one in found]
        write_report(page, title, series, metrics_tables(series), notes)
    say(console, *remarks)
    for table in case_tables(title, schemes):
        print_table(console, table)
    if page is not None:
        say(console, f"report: {page}")


def _many(
    found: Sequence[Case],
    comparison: Comparison,
    workers: int,
    scheduler: str | None,
    console: Console,
) -> list[CaseResult]:
    """Run many cases with a progress bar; return their results in order."""
    from studies.compare.study import run_case
    from studies.workers import share_over_cluster, share_work

    run = partial(run_case, comparison)
    if scheduler is not None:
        shared = share_over_cluster(run, found, scheduler)
    else:
        shared = share_work(run, found, workers)
    results = dict(counted(shared, "cases", len(found), console))
    return [results[number] for number in sorted(results)]


def _print_many(results: Sequence[CaseResult], show: str, console: Console) -> None:
    from studies.compare.tables import cases_table

    say(console, *dict.fromkeys(line for result in results for line in result.remarks))
    print_table(console, cases_table(show, results))
    prepare_s = sum(result.prepare_s for result in results)
    run_s = sum(result.run_s for result in results)
    say(
        console,
        f"sky and market took {prepare_s:.1f} s, the schemes and their figures {run_s:.1f} s, "
        "added up over all cases",
    )
