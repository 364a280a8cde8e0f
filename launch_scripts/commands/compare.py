"""`heliarch compare`: control schemes side by side, on one day or on many; or two recorded runs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

import typer

from agents.settings import Actuator
from bus_schemas.errors import InputError
from launch_scripts.commands.options import ResultOptions, refuse_others
from launch_scripts.commands.output import counted, say, write_json, written
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions
from studies.tables import Table, console_for, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from studies.arrays.schemes import ReferenceGroups
    from studies.compare.cases import Case
    from studies.compare.study import CaseResult, Comparison


def compare(
    context: typer.Context,
    scenario: str = "oahu-day",
    other: Path | None = None,
    *,
    span: TimeOptions,
    days: str | None = None,
    seeds: str | None = None,
    settings: list[str] | None = None,
    schemes: str | None = None,
    actuator: str | None = None,
    reference: str | None = None,
    show: str = "control-caused,over-delivered",
    workers: int = 1,
    scheduler: str | None = None,
    files: ResultOptions,
    csv: str | None = None,
) -> None:
    """Compare control schemes under the same sky, for one day or many; or two recorded runs.

    For a single case or two runs, --report writes a page, compare.html by default.

    SCENARIO: A shipped scenario (see `heliarch scenarios`) or a TOML file; or a recorded run, its
        folder or run.mcap.
    RUN (other): A second run, to compare the first with.
    --days DATES: Dates, such as 2010-04-01..2010-04-30.
    --seeds SEEDS: Seeds of synthetic clouds, such as 1..5,9.
    --set FIELD=VALUES (settings): A field of the scenario and its values; each combination is a
        case.
    --schemes NAMES: Control schemes, with commas: uncontrolled, uniform-cap, grouping, paper,
        predictive, physical-limit. Default all.
    --actuator NAMES: Actuators that each scheme is run with: fraction,limit. Default that of the
        scenario.
    --reference GROUPS: Reference groups of grouping control: sizes (1,4,8), or inverters
        (inv01,inv07).
    --show FIGURES: Figures of merit to show for many cases, with commas: desired-energy,
        possible-energy, delivered-energy, satisfied, shortfall-energy, unavoidable-energy,
        control-caused-energy, over-delivered-energy, shortfall, unavoidable, control-caused,
        over-delivered, rmse, mae, mileage-total, mileage, mileage-per-minute, headroom,
        mean-headroom, ancillary-potential, rise, fall, ramp, ramp-limit, above-ramp-limit,
        capacity, offered, signal-mileage, regd-strict, regd, regd-feasible-strict, regd-feasible,
        accuracy, delay, precision, score, score-unclipped.
    --scheduler ADDRESS: Dask scheduler that shares the cases.
    --csv FILE: Write the summary of the cases as CSV.
    Example: heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10
    """
    if other is not None:
        allowed = ("scenario", "other", "report", "json")
        refuse_others(context, allowed, "expected a scenario to go with it, got two runs")
        _two_runs((Path(scenario), other), files)
        return
    if _is_run(Path(scenario)):
        raise InputError(f"{scenario}: expected a second run to compare it with, or a scenario")
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.arrays.schemes import SCHEMES
    from studies.compare.cases import cases, parse_days, parse_seeds, parse_setting
    from studies.compare.study import Comparison
    from studies.metrics.figures_of_merit import FIGURES_OF_MERIT

    shown = _names("--show", show, FIGURES_OF_MERIT)
    found = cases(
        load_scenario(scenario, files.data),
        RunOptions(**vars(span)),
        [parse_setting(text) for text in settings or ()],
        () if days is None else parse_days(days),
        () if seeds is None else parse_seeds(seeds),
    )
    if scheduler is not None and len(found) == 1:
        raise InputError("--scheduler: expected cases to share (--seeds, --days, --set), got one")
    if files.report is not None and len(found) > 1:
        raise InputError(f"--report: expected one case, got {len(found):,}; see --csv and --json")
    actuators = _names("--actuator", actuator, get_args(Actuator)) if actuator else ()
    comparison = Comparison(
        tuple(SCHEMES) if schemes is None else _names("--schemes", schemes, SCHEMES),
        _groups(reference),
        cast(tuple[Actuator, ...], actuators),
    )
    if len(found) == 1:
        _one(found[0], comparison, files, csv)
    else:
        _many(found, comparison, workers, scheduler, shown, files.json, csv)


def _is_run(path: Path) -> bool:
    return path.suffix == ".mcap" or (path / "run.mcap").exists()


def _names(option: str, text: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the names of a text with commas, each once."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in known:
            raise InputError(f"{option}: expected {', '.join(known)}, got {name}")
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


def _one(case: Case, comparison: Comparison, files: ResultOptions, csv: str | None) -> None:
    """Run one case and print the paper's tables; write a page and files of it if asked for."""
    from launch_scripts.scenarios.preparation import prepare
    from studies.compare.results import case_tables, json_rows
    from studies.compare.study import CaseResult, remarks_of, results_of

    preparation = prepare(case.scenario, case.options, "compare")
    remarks = remarks_of(preparation)
    found = list(results_of(preparation, comparison))
    schemes = tuple(result for result, _ in found)
    title = preparation.title()
    results = [CaseResult(case.label, "", schemes, 0.0, 0.0, remarks)]
    tables = case_tables(title, schemes)

    def page() -> str:
        from studies.compare.frontier import frontier
        from studies.report.run_report import report_page
        from studies.report.tables import metrics_tables

        notes = [f"Scenario: {preparation.scenario.scenario.title}.", *remarks]
        series = [one for _, one in found]
        merits = metrics_tables(series)
        return report_page(title, series, [*tables, frontier(schemes), *merits], notes)

    _write_summary(results, csv)
    with written(json_rows(results), files, page, "compare.html") as console:
        _print(console, remarks, tables)


def _two_runs(paths: tuple[Path, Path], files: ResultOptions) -> None:
    """Print two recordings side by side; write a page and JSON of them if asked for."""
    from studies.compare.runs import read_two_runs, two_runs_tables
    from studies.report.run_report import report_page
    from studies.tables import json_rows

    for path in paths:
        if not _is_run(path):
            raise InputError(
                f"{path}: expected a recorded run, its folder or run.mcap; schemes are compared on "
                "one scenario alone"
            )
    series, lines = read_two_runs(paths)
    tables = two_runs_tables(*series)
    figures, differences = map(json_rows, tables)
    runs = [str(path) for path in paths]
    document = {"runs": runs, "figures": figures, "differences": differences}
    title = f"{paths[0].name} and {paths[1].name}"
    page = partial(report_page, title, series, tables, lines[1:], lead=lines[0])
    with written(document, files, page, "compare.html") as console:
        _print(console, lines, tables)


def _print(console: Console, lines: Sequence[str], tables: Sequence[Table]) -> None:
    say(console, *lines)
    for table in tables:
        print_table(console, table)


def _many(
    found: Sequence[Case],
    comparison: Comparison,
    workers: int,
    scheduler: str | None,
    shown: Sequence[str],
    json: str | None,
    csv: str | None,
) -> None:
    """Run many cases with a progress bar; print them and their summary, and write files of them."""
    from studies.compare.results import cases_tables, json_rows
    from studies.compare.study import run_case
    from studies.workers import share_over_cluster, share_work

    run = partial(run_case, comparison)
    numbered = (
        share_work(run, found, workers)
        if scheduler is None
        else share_over_cluster(run, found, scheduler)
    )
    results = counted(numbered, "cases", len(found))
    # The files first: whoever reads the table may leave before its end.
    write_json(json_rows(results), json)
    _write_summary(results, csv)
    console = console_for(json)
    remarks = dict.fromkeys(line for result in results for line in result.remarks)
    _print(console, list(remarks), cases_tables(shown, results))
    prepare_s = sum(result.prepare_s for result in results)
    run_s = sum(result.run_s for result in results)
    say(
        console,
        f"sky and market took {prepare_s:.1f} s, the schemes and their figures {run_s:.1f} s, "
        "added up over all cases",
    )


def _write_summary(results: Sequence[CaseResult], csv: str | None) -> None:
    """Write the summary of the cases as CSV, where it is asked for."""
    if csv is not None:
        from pandas import DataFrame

        from recordings.read.whole_file import whole_file
        from studies.compare.results import summaries

        with whole_file(Path(csv)) as file:
            DataFrame(summaries(results)).to_csv(file, index=False)
