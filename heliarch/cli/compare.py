"""`heliarch compare`: control schemes side by side, on one day or on many."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, cast, get_args

from cyclopts import Parameter

from agents.settings import Actuator
from bus_schemas.errors import InputError
from bus_schemas.whole_file import whole_file
from heliarch.cli.options import (
    FILES,
    ResultOptions,
    Settings,
    Workers,
    is_run,
    new_table,
)
from heliarch.cli.output import do_all, publish, shared
from results.report.result import Result
from scenarios.run_options import FAULTS, RunOptions, TimeOptions, check_names

if TYPE_CHECKING:
    from studies.compare.cases import Case
    from studies.compare.study import Row

_SETTINGS: Final = (
    "A field of the scenario and its values; each combination is a case. Whole numbers may be a "
    "range: control.clusters_seed=1..20."
)


def compare(
    scenario: str = "oahu-day",
    /,
    *,
    days: Annotated[str | None, Parameter(metavar="DATES")] = None,
    seeds: Annotated[str | None, Parameter(metavar="SEEDS")] = None,
    schemes: Annotated[str | None, Parameter(metavar="NAMES")] = None,
    actuator: Annotated[str | None, Parameter(metavar="NAMES")] = None,
    show: Annotated[str, Parameter(metavar="FIGURES")] = "control-caused,over-delivered",
    workers: Workers = 1,
    cluster: Annotated[str, Parameter(metavar="ADDRESS")] = "",
    settings: Annotated[Settings, Parameter(metavar="FIELD=VALUES", help=_SETTINGS)] = None,
    span: TimeOptions = TimeOptions(),
    faults: Annotated[list[str] | None, Parameter("--fault", metavar="RULES", group=FAULTS)] = None,
    files: ResultOptions = ResultOptions(),
    csv: Annotated[str | None, Parameter(metavar="FILE", group=FILES, validator=new_table)] = None,
) -> None:
    """Compare control schemes under the same sky.

    For one day or many.

    For a single case, --report writes a page, compare.html by default.

    Example: `heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10`

    Parameters
    ----------
    scenario
        A shipped scenario (see `heliarch scenarios`) or a TOML file.
    days
        Dates, such as 2010-04-01..2010-04-30.
    seeds
        Seeds of synthetic clouds, such as 1..5,9.
    schemes
        Control schemes, with commas: uncontrolled, uniform-cap, grouping, paper, predictive,
        physical-limit. Default: all.
    actuator
        Actuators to run each scheme with: fraction,limit. Default: the scenario's.
    show
        Figures of merit to show for many cases, with commas, by their names in docs/metrics.md
        and in --json.
    cluster
        Address of a Dask scheduler, such as tcp://host:8786: its workers share the cases instead.
    faults
        A rule as for `simulate`, several that act together (delay=1s;loss=5%), or none. May be
        given several times: each is a case.
    csv
        Write the summary of the cases as CSV.
    """
    if is_run(Path(scenario)):
        expected = "a scenario (`heliarch diff RUN RUN` compares two runs)"
        raise InputError(f"{scenario}: expected {expected}, got a run")
    from results.figures import FIGURES
    from scenarios.scenario import load_scenario
    from scenarios.settings import parse_setting
    from studies.arrays.schemes import SCHEMES, schemes_for
    from studies.compare import results
    from studies.compare.cases import cases, parse_days, parse_seeds
    from studies.compare.study import run_case

    shown = _names("--show", show, FIGURES)
    file = load_scenario(scenario, files.data)
    known = schemes_for(file.scenario)
    names = known if schemes is None else _names("--schemes", schemes, SCHEMES)
    actuators = cast(tuple[Actuator, ...], _names("--actuator", actuator, get_args(Actuator)))
    chosen = [parse_setting(text) for text in settings or ()]
    found = cases(
        file,
        RunOptions.of(span),
        chosen,
        faults or (),
        () if days is None else parse_days(days),
        () if seeds is None else parse_seeds(seeds),
    )
    if len(found) == 1:
        result, rows = _one_case(found[0], names, actuators)
        of_cases = [rows]
    elif files.report is not None:
        raise InputError.of(
            "--report", f"expected one case, got {len(found):,}; see --csv and --json"
        )
    else:
        run = partial(run_case, names, actuators)
        of_cases = shared(run, found, workers, "cases", cluster)
        result = _many_cases(of_cases, shown)

    def write_summary() -> None:
        if csv is not None:
            with whole_file(Path(csv)) as table:
                results.summaries(of_cases).to_csv(table, index=False)

    do_all(write_summary, partial(publish, result, files, "compare.html"))


def _names(option: str, text: str | None, known: Collection[str]) -> tuple[str, ...]:
    names = [name.strip() for name in (text or "").split(",") if name.strip()]
    check_names(option, names, known)
    return tuple(dict.fromkeys(names))


def _one_case(
    case: Case, schemes: Sequence[str], actuators: Sequence[Actuator]
) -> tuple[Result, list[Row]]:
    """Run one case; return the paper's tables and figures, and its rows."""
    from results.report.run_report import runs_result
    from results.report.tables import figures_tables
    from scenarios.preparation import prepare
    from studies.compare.frontier import frontier
    from studies.compare.results import case_tables
    from studies.compare.study import remarks_of, run_schemes

    preparation = prepare(case.scenario, case.options, "compare")
    found, series = zip(*run_schemes(preparation, schemes, actuators), strict=True)
    rows = [{**case.columns, **row} for row in found]
    title, remarks = preparation.title(), remarks_of(preparation)
    lines = [f"Scenario: {preparation.scenario.scenario.title}.", *([remarks] if remarks else [])]
    result = runs_result(title, series, case_tables(title, rows), lines, _json([rows]))
    return replace(
        result,
        figures=lambda: [frontier(rows), *result.figures()],
        details=figures_tables(series),
    ), rows


def _many_cases(results: Sequence[Sequence[Row]], shown: Sequence[str]) -> Result:
    from studies.compare.results import cases_tables

    remarks = dict.fromkeys(row["remarks"] for rows in results for row in rows if row["remarks"])
    title = f"{len(results):,} cases"
    return Result(title, cases_tables(shown, results), _json(results), lines=list(remarks))


def _json(results: Sequence[Sequence[Row]]) -> list[Row]:
    from studies.compare.results import case_label

    return [{"case": case_label(row), **row} for rows in results for row in rows]
