"""The tables of a comparison, and its rows for JSON and CSV."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial, reduce
from itertools import product
from typing import Final

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from agents.settings import Actuator
from studies.compare.study import CaseResult, SchemeResult
from studies.metrics.figures_of_merit import (
    FIGURES_OF_MERIT,
    FigureOfMerit,
    figures_json,
    shown_in,
)
from studies.tables import Cell, Column, Table, cell_text, key_column

QUANTILES: Final = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}
_UPPER: Final = 0.975
"""Of an interval that holds the true mean with 95 %, both tails alike."""

AXES: Final = ("control-caused", "over-delivered", "rmse")
"""Figures of merit that only count together: one is easily had at the cost of another."""

_LISTED: Final = 40
"""Up to this many cases have a row each."""

_NOTES: Final = (
    "* best of its column; rows without an actuator are bounds and do not compete",
    "best, median and worst reference group: by control-caused plus over-delivered energy",
)


def case_tables(title: str, schemes: Sequence[SchemeResult]) -> list[Table]:
    """Return the paper's tables for one case, a row for each scheme."""
    axes = tuple(FIGURES_OF_MERIT[name] for name in AXES)
    others = (one for one in shown_in("compare", "commitment") if one not in axes)
    tables = [_scheme_table(title, schemes, (*axes, *others))]
    if any(entry.metrics.regulation for entry in schemes):
        figures = shown_in("compare", "regulation")
        tables.append(_scheme_table("Regulation signal", schemes, figures))
    return tables


def _scheme_table(
    title: str, schemes: Sequence[SchemeResult], figures: Sequence[FigureOfMerit]
) -> Table:
    columns = key_column("scheme"), key_column("actuator"), *(figure.column for figure in figures)
    cells = [_with_mark(figure, schemes) for figure in figures]
    rows = [
        (entry.scheme, entry.actuator, *row)
        for entry, row in zip(schemes, zip(*cells, strict=True), strict=True)
    ]
    has_groups = any(entry.scheme == "grouping best" for entry in schemes)
    return Table(title, columns, rows, _NOTES if has_groups else _NOTES[:1])


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
    """Return figures of merit of many cases: case by case if they are few, and summarised."""
    figures = [FIGURES_OF_MERIT[name] for name in names]
    tables = [_cases_table(figures, results)] if len(results) <= _LISTED else []
    return [*tables, *(_summary_table(figure, results) for figure in figures)]


def _cases_table(figures: Sequence[FigureOfMerit], results: Sequence[CaseResult]) -> Table:
    """Return a row for each case, and of each scheme the first figure with the others in brackets.

    Mean and quantiles of all cases stand below.
    """
    texts = []
    for figure in figures:
        values = values_of(figure, results)
        quantiles = values.quantile([*QUANTILES.values()]).set_axis([*QUANTILES])
        rows = pd.concat([values, values.agg(["mean"]), quantiles])
        texts.append(rows.map(partial(cell_text, column=figure.column)))
    title, *titles = (figure.heading for figure in figures)
    shown, *others = texts
    if others:
        title += f" ({', '.join(titles)})"
        shown += " (" + reduce(lambda some, other: some + ", " + other, others) + ")"
    columns = [
        Column(entry.scheme, actuator or "")
        for entry, actuator in zip(results[0].schemes, actuators_of(results), strict=True)
    ]
    return Table(title, [key_column("case"), *columns], shown.reset_index().to_numpy().tolist())


def _summary_table(figure: FigureOfMerit, results: Sequence[CaseResult]) -> Table:
    found = summaries(results, [figure])
    less = f"less {found.baseline.iloc[0]}" if len(found) else "difference"
    titles = {
        "mean": "mean",
        "mean_error": "± 95 %",
        "low": "5 %",
        "median": "median",
        "high": "95 %",
        "difference": less,
        "difference_error": "± 95 %",
    }
    keys = ["settings"] if found.settings.any() else []
    columns = [
        *map(key_column, (*keys, "scheme", "actuator")),
        *(Column(title, "", figure.decimals, name=name) for name, title in titles.items()),
    ]
    rows = found[[column.name or column.title for column in columns]].to_numpy(dtype=object)
    return Table(f"{figure.heading}, {len(results):,} cases", columns, rows.tolist())


def json_rows(results: Sequence[CaseResult]) -> list[dict[str, object]]:
    """Return a row for each case and scheme: all figures of merit, all metrics, remarks."""
    return [
        {
            "case": result.label,
            "scheme": entry.scheme,
            "actuator": entry.actuator,
            **figures_json(entry.metrics),
            "metrics": entry.metrics,
            "remarks": result.remarks,
        }
        for result in results
        for entry in result.schemes
    ]


def summaries(
    results: Sequence[CaseResult],
    figures: Iterable[FigureOfMerit] = tuple(FIGURES_OF_MERIT.values()),
) -> pd.DataFrame:
    """Summarise each figure of each scheme over the cases with the same settings.

    If every case has settings of its own, all cases are taken together. Errors are half the width
    of a 95 % interval by Student's t, NaN for one case. `difference` is the mean of the scheme less
    the baseline, `predictive` or else the first scheme, with the same actuator.
    """
    samples: dict[str, list[CaseResult]] = {}
    for result in results:
        samples.setdefault(result.settings, []).append(result)
    if len(samples) == len(results):
        samples = {"": list(results)}
    entries = results[0].schemes
    names = [entry.scheme for entry in entries]
    baseline = "predictive" if "predictive" in names else names[0]
    baselines = {
        entry.actuator: place for place, entry in enumerate(entries) if entry.scheme == baseline
    }
    beside = [baselines.get(entry.actuator, names.index(baseline)) for entry in entries]
    found = []
    for figure, (settings, cases) in product(figures, samples.items()):
        values = values_of(figure, cases)
        less = values - values[beside].to_numpy()
        less[beside] = np.nan
        low, median, high = (values.quantile(share) for share in QUANTILES.values())
        columns = {
            "figure": figure.name,
            "unit": figure.unit,
            "settings": settings,
            "scheme": names,
            "actuator": actuators_of(cases),
            "cases": values.count(),
            "mean": values.mean(),
            "mean_error": _half_interval(values),
            "low": low,
            "median": median,
            "high": high,
            "baseline": baseline,
            "difference": less.mean(),
            "difference_error": _half_interval(less),
        }
        found.append(pd.DataFrame(columns).query("cases > 0"))
    return pd.concat(found)


def values_of(figure: FigureOfMerit, cases: Sequence[CaseResult]) -> pd.DataFrame:
    """Return a figure with a row for each case, a column for each scheme; NaN: not defined."""
    rows = [[figure.read(entry.metrics) for entry in case.schemes] for case in cases]
    return pd.DataFrame(rows, [case.label for case in cases], dtype=float)


def actuators_of(cases: Sequence[CaseResult]) -> list[Actuator | None]:
    """Return the actuator of each scheme; None for a bound, and where cases differ in it."""
    of_schemes = zip(*([entry.actuator for entry in case.schemes] for case in cases), strict=True)
    return [found[0] if len(set(found)) == 1 else None for found in of_schemes]


def _half_interval(values: pd.DataFrame) -> pd.Series:
    return values.sem() * stdtrit(values.count() - 1, _UPPER)
