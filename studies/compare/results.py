"""The tables of a comparison, and its rows for JSON and CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Final

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from agents.settings import Actuator
from results.metrics.figures_of_merit import (
    AGENTS,
    COMMITMENT,
    FIGURES_OF_MERIT,
    REGULATION,
    FigureOfMerit,
    Shown,
    figures_json,
    shown_in,
)
from results.tables import Cell, Column, Table, cell_text, key_column
from studies.compare.cases import label
from studies.compare.study import CaseResult, SchemeResult

QUANTILES: Final = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}
_UPPER: Final = 0.975
"""Of an interval that holds the true mean with 95 %, both tails alike."""

AXES: Final = ("control-caused", "over-delivered", "rmse")
"""Figures of merit that only count together: one is easily had at the cost of another."""

_LISTED: Final = 40
"""Up to this many cases have a row each."""

_DRAWS: Final = ("day", "seed")
"""What cases of one sample differ in."""

_NOTES: Final = (
    "* best of its column; rows without an actuator are bounds and do not compete",
    "best, median and worst reference group: by control-caused plus over-delivered energy",
)


def case_tables(title: str, schemes: Sequence[SchemeResult]) -> list[Table]:
    """Return the paper's tables for one case, a row for each scheme."""
    axes = tuple(FIGURES_OF_MERIT[name] for name in AXES)
    others = (one for one in shown_in(Shown.COMPARE, COMMITMENT) if one not in axes)
    tables = [_scheme_table(title, schemes, (*axes, *others))]
    if any(entry.metrics.regulation for entry in schemes):
        figures = shown_in(Shown.COMPARE, REGULATION)
        tables.append(_scheme_table("Regulation signal", schemes, figures))
    if hierarchical := [entry for entry in schemes if entry.metrics.help]:
        figures = shown_in(Shown.COMPARE, AGENTS)
        rows = [
            (entry.scheme, entry.actuator, *(figure.read(entry.metrics) for figure in figures))
            for entry in hierarchical
        ]
        tables.append(Table("Help, missed inputs and reverts", _scheme_columns(figures), rows))
    return tables


def _scheme_columns(figures: Sequence[FigureOfMerit]) -> tuple[Column, ...]:
    return key_column("scheme"), key_column("actuator"), *(figure.column for figure in figures)


def _scheme_table(
    title: str, schemes: Sequence[SchemeResult], figures: Sequence[FigureOfMerit]
) -> Table:
    cells = [_with_mark(figure, schemes) for figure in figures]
    rows = [
        (entry.scheme, entry.actuator, *row)
        for entry, row in zip(schemes, zip(*cells, strict=True), strict=True)
    ]
    has_groups = any(entry.scheme == "grouping best" for entry in schemes)
    return Table(title, _scheme_columns(figures), rows, _NOTES if has_groups else _NOTES[:1])


def _with_mark(figure: FigureOfMerit, schemes: Sequence[SchemeResult]) -> list[Cell]:
    """Return a figure of each scheme, the best with a star, unless all that compete are alike."""
    values = [figure.read(entry.metrics) for entry in schemes]
    ranked = {
        value: cell_text(value, figure.column)
        for value, entry in zip(values, schemes, strict=True)
        if entry.actuator and value is not None
    }
    if len(set(ranked.values())) < 2:
        return list(values)
    best = ranked[max(ranked) if figure.is_more_better else min(ranked)]
    return [
        f"*{best}" if entry.actuator and cell_text(value, figure.column) == best else value
        for value, entry in zip(values, schemes, strict=True)
    ]


def cases_tables(names: Sequence[str], results: Sequence[CaseResult]) -> list[Table]:
    """Return figures of merit of many cases: case by case if they are few, then summaries.

    Where each case has settings of its own, there is nothing to summarise.
    """
    figures = [FIGURES_OF_MERIT[name] for name in names]
    is_listed = len(results) <= _LISTED
    tables = [_cases_table(figures, results)] if is_listed else []
    if len(_samples(results)) < len(results) or not is_listed:
        tables += [_summary_table(figure, results) for figure in figures]
    return tables


def _cases_table(figures: Sequence[FigureOfMerit], results: Sequence[CaseResult]) -> Table:
    """Return a row for each case; of each scheme the first figure, the others in brackets."""
    title, *others = (figure.heading for figure in figures)
    columns = [
        Column(entry.scheme, actuator or "")
        for entry, actuator in zip(results[0].schemes, _actuators_of(results), strict=True)
    ]
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        cells = []
        for entry in result.schemes:
            first, *rest = (cell_text(one.read(entry.metrics), one.column) for one in figures)
            cells.append(f"{first} ({', '.join(rest)})" if rest else first)
        rows.append((label(result.columns), *cells))
    heading = f"{title} ({', '.join(others)})" if others else title
    return Table(heading, [key_column("case"), *columns], rows)


def _summary_table(figure: FigureOfMerit, results: Sequence[CaseResult]) -> Table:
    rows = summaries(results, [figure])
    less = f"less {rows.baseline.iloc[0]}" if len(rows) else "difference"
    titles = {
        "mean": "mean",
        "mean_error": "± 95 %",
        "low": "5 %",
        "median": "median",
        "high": "95 %",
        "difference": less,
        "difference_error": "± 95 %",
    }
    if rows.mean_error.isna().all():
        titles = {name: title for name, title in titles.items() if title != "± 95 %"}
    keys = ["settings"] if rows.settings.any() else []
    columns = [
        *map(key_column, (*keys, "scheme", "actuator")),
        *(Column(title, "", figure.decimals, name=name) for name, title in titles.items()),
    ]
    cells = rows[[column.name or column.title for column in columns]].to_numpy(dtype=object)
    return Table(f"{figure.heading}, {len(results):,} cases", columns, cells.tolist())


def result_rows(results: Sequence[CaseResult]) -> list[dict[str, object]]:
    """Return a row for each case and scheme: what the case differs in, and all figures of merit."""
    return [
        {
            **result.columns,
            "scheme": entry.scheme,
            "actuator": entry.actuator,
            **figures_json(entry.metrics),
        }
        for result in results
        for entry in result.schemes
    ]


def json_rows(results: Sequence[CaseResult]) -> list[dict[str, object]]:
    """Return the same rows with a label of the case, all metrics and remarks."""
    entries = [(result, entry) for result in results for entry in result.schemes]
    return [
        {
            "case": label(result.columns),
            **row,
            "metrics": entry.metrics,
            "remarks": result.remarks,
        }
        for row, (result, entry) in zip(result_rows(results), entries, strict=True)
    ]


def summaries(
    results: Sequence[CaseResult],
    figures: Iterable[FigureOfMerit] = tuple(FIGURES_OF_MERIT.values()),
) -> pd.DataFrame:
    """Summarise each figure of each scheme over the cases with the same settings and faults.

    Errors are half the width of a 95 % interval by Student's t. Only seeds are independent draws:
    for cases of which no two have different seeds, and for one case, errors are NaN. `difference`
    is the mean of the scheme less the baseline, `predictive` or else the first scheme, with the
    same actuator.
    """
    schemes = results[0].schemes
    names = [entry.scheme for entry in schemes]
    baseline = "predictive" if "predictive" in names else names[0]
    baselines = {
        entry.actuator: column for column, entry in enumerate(schemes) if entry.scheme == baseline
    }
    beside = [baselines.get(entry.actuator, names.index(baseline)) for entry in schemes]
    tables = []
    for figure, (settings, cases) in product(figures, _samples(results).items()):
        values = _values_of(figure, cases)
        less = values - values[beside].to_numpy()
        less[beside] = np.nan
        low, median, high = (values.quantile(share) for share in QUANTILES.values())
        is_drawn = len({case.columns.get("seed") for case in cases}) == len(cases)
        columns = {
            "figure": figure.name,
            "unit": figure.unit,
            "settings": settings,
            "scheme": names,
            "actuator": _actuators_of(cases),
            "cases": values.count(),
            "mean": values.mean(),
            "mean_error": _half_interval(values) if is_drawn else np.nan,
            "low": low,
            "median": median,
            "high": high,
            "baseline": baseline,
            "difference": less.mean(),
            "difference_error": _half_interval(less) if is_drawn else np.nan,
        }
        tables.append(pd.DataFrame(columns).query("cases > 0"))
    return pd.concat(tables)


def _samples(results: Sequence[CaseResult]) -> Mapping[str, Sequence[CaseResult]]:
    """Return the cases that differ in nothing but day and seed, by their settings."""
    samples: dict[str, list[CaseResult]] = {}
    for result in results:
        settings = {name: value for name, value in result.columns.items() if name not in _DRAWS}
        samples.setdefault(label(settings), []).append(result)
    return samples


def _values_of(figure: FigureOfMerit, cases: Sequence[CaseResult]) -> pd.DataFrame:
    """Return a figure with a row for each case, a column for each scheme; NaN: not defined."""
    return pd.DataFrame(
        [[figure.read(entry.metrics) for entry in case.schemes] for case in cases], dtype=float
    )


def _actuators_of(cases: Sequence[CaseResult]) -> list[Actuator | None]:
    """Return the actuator of each scheme; None for a bound, and where cases differ in it."""
    of_schemes = zip(*([entry.actuator for entry in case.schemes] for case in cases), strict=True)
    return [names[0] if len(set(names)) == 1 else None for names in of_schemes]


def _half_interval(values: pd.DataFrame) -> pd.Series:
    return values.sem() * stdtrit(values.count() - 1, _UPPER)
