"""`heliarch compare`: control schemes side by side, on one day or on many; or two recorded runs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

import typer

from agents.settings import Actuator
from bus_schemas.errors import InputError
from launch_scripts.commands.options import ResultOptions, is_run, refuse_others
from launch_scripts.commands.output import do_all, publish, shared
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions
from studies.report.result import Result

if TYPE_CHECKING:
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
        predictive, physical-limit. Default: all.
    --actuator NAMES: Actuators to run each scheme with: fraction,limit. Default: the scenario's.
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
        publish(_two_runs((Path(scenario), other)), files, "compare.html")
        return
    if is_run(Path(scenario)):
        raise InputError(f"{scenario}: expected two runs, or one scenario")
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.arrays.schemes import SCHEMES
    from studies.compare.cases import cases, parse_days, parse_seeds, parse_setting
    from studies.compare.results import cases_tables, json_rows
    from studies.compare.study import Comparison, run_case
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
        result, *results = _one(found[0], comparison)
    else:
        results = shared(partial(run_case, comparison), found, workers, "cases", scheduler)
        result = Result(
            f"{len(results):,} cases",
            cases_tables(shown, results),
            json_rows(results),
            lines=list(dict.fromkeys(line for one in results for line in one.remarks)),
        )
    do_all(
        partial(_write_summary, results, csv),
        partial(publish, result, files, "compare.html"),
    )


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
    if all(name.isdecimal() for name in names):
        return ReferenceGroups(sizes=tuple(int(name) for name in names))
    return ReferenceGroups(members=names)


def _one(case: Case, comparison: Comparison) -> tuple[Result, CaseResult]:
    """Run one case; return the paper's tables and figures."""
    from launch_scripts.scenarios.preparation import prepare
    from studies.compare.frontier import frontier
    from studies.compare.results import case_tables, json_rows
    from studies.compare.study import CaseResult, remarks_of, results_of
    from studies.report.run_report import runs_result
    from studies.report.tables import metrics_tables

    preparation = prepare(case.scenario, case.options, "compare")
    remarks = remarks_of(preparation)
    schemes, series = zip(*results_of(preparation, comparison), strict=True)
    found = CaseResult(case.label, "", schemes, remarks)
    title = preparation.title()
    lines = [f"Scenario: {preparation.scenario.scenario.title}.", *remarks]
    tables, document = case_tables(title, schemes), json_rows([found])
    result = runs_result(title, series, tables, lines, document)
    return replace(
        result,
        figures=lambda: [frontier(schemes), *result.figures()],
        details=metrics_tables(series),
    ), found


def _two_runs(paths: tuple[Path, Path]) -> Result:
    """Put two recordings side by side."""
    from studies.compare.runs import read_two_runs, two_runs_tables
    from studies.report.run_report import runs_result
    from studies.tables import json_rows

    for path in paths:
        if not is_run(path):
            raise InputError(f"{path}: expected a recorded run, its folder or run.mcap")
    series, lines = read_two_runs(paths)
    tables = two_runs_tables(*series)
    figures, differences = map(json_rows, tables)
    runs = [str(path) for path in paths]
    document = {"runs": runs, "figures": figures, "differences": differences}
    return runs_result(f"{paths[0].name} and {paths[1].name}", series, tables, lines, document)


def _write_summary(results: Sequence[CaseResult], csv: str | None) -> None:
    """Write the summary of the cases as CSV, where it is asked for."""
    if csv is not None:
        from recordings.read.whole_file import whole_file
        from studies.compare.results import summaries

        with whole_file(Path(csv)) as file:
            summaries(results).to_csv(file, index=False)
