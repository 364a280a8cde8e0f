"""The tables of a comparison and its summary, from a row for each scheme in each case."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, get_args

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from agents.settings import Scheme
from results.figures import FIGURES, Figure, Shown, shown_in
from results.tables import Cell, Column, Table, cell_text, key_column
from studies.compare.cases import label
from studies.compare.study import Row

AXES: Final = ("control-caused", "over-delivered", "rmse")
"""Figures of merit that only count together: one is easily had at the cost of another."""

_UPPER: Final = 0.975
"""Of an interval that holds the true mean with 95 %, both tails alike."""

_LISTED: Final = 40
"""Up to this many cases have a row each."""

_DRAWS: Final = ("day", "seed")
"""What cases of one sample differ in."""

_OF_ROW: Final = {"scheme", "actuator", "remarks", *FIGURES}

_SUMMARY: Final = {
    "mean": "mean",
    "mean_error": "± 95 %",
    "low": "5 %",
    "median": "median",
    "high": "95 %",
    "difference": "difference",
    "difference_error": "± 95 %",
}

_NOTES: Final = (
    "* best of its column; rows without an actuator are bounds and do not compete",
    "best, median and worst reference group: by control-caused plus over-delivered energy",
)


def case_tables(title: str, rows: Sequence[Row]) -> list[Table]:
    """Return the paper's tables for one case, a row for each scheme."""
    axes = tuple(FIGURES[name] for name in AXES)
    others = (
        one
        for one in shown_in(Shown.COMPARE, Shown(0))
        if one not in axes and any(row[one.name] is not None for row in rows)
    )
    tables = [_scheme_table(title, rows, (*axes, *others))]
    if any(row["capacity"] is not None for row in rows):
        figures = shown_in(Shown.COMPARE, Shown.REGULATION)
        tables.append(_scheme_table("Regulation signal", rows, figures))
    if hierarchical := [row for row in rows if row["scheme"] in get_args(Scheme)]:
        figures = shown_in(Shown.COMPARE, Shown.AGENTS)
        cells = [(*_keys(row), *(row[one.name] for one in figures)) for row in hierarchical]
        tables.append(Table("Help, missed inputs and reverts", _columns(figures), cells))
    return tables


def _keys(row: Row) -> tuple[str, str | None]:
    return row["scheme"], row["actuator"]


def _columns(figures: Sequence[Figure]) -> tuple[Column, ...]:
    return key_column("scheme"), key_column("actuator"), *(figure.column for figure in figures)


def _scheme_table(title: str, rows: Sequence[Row], figures: Sequence[Figure]) -> Table:
    cells = zip(*(_with_mark(figure, rows) for figure in figures), strict=True)
    marked = [(*_keys(row), *of_row) for row, of_row in zip(rows, cells, strict=True)]
    has_groups = any(row["scheme"] == "grouping best" for row in rows)
    return Table(title, _columns(figures), marked, _NOTES if has_groups else _NOTES[:1])


def _with_mark(figure: Figure, rows: Sequence[Row]) -> list[Cell]:
    """Return a figure of each scheme, the best with a star, unless all that compete are alike."""
    values = [row[figure.name] for row in rows]
    texts = [cell_text(value, figure.column) for value in values]
    competes = [bool(row["actuator"]) and row[figure.name] is not None for row in rows]
    ranked = {values[at]: texts[at] for at in np.flatnonzero(competes)}
    if len(set(ranked.values())) < 2:
        return values
    best = ranked[max(ranked) if figure.is_more_better else min(ranked)]
    return [
        f"*{best}" if does and text == best else value
        for value, text, does in zip(values, texts, competes, strict=True)
    ]


def cases_tables(names: Sequence[str], cases: Sequence[Sequence[Row]]) -> list[Table]:
    """Return figures of merit of many cases: case by case if they are few, then summaries.

    Where each case has settings of its own, there is nothing to summarise.
    """
    figures = [FIGURES[name] for name in names]
    is_listed = len(cases) <= _LISTED
    tables = [_cases_table(figures, cases)] if is_listed else []
    samples = {_settings(rows[0]) for rows in cases}
    if len(samples) < len(cases) or not is_listed:
        tables += [_summary_table(figure, cases) for figure in figures]
    return tables


def case_label(row: Row, without: Iterable[str] = ()) -> str:
    """Name the case of a row by what cases differ in."""
    return label({name: row[name] for name in row if name not in {*_OF_ROW, *without}})


def _settings(row: Row) -> str:
    """Name what the cases of one sample have in common."""
    return case_label(row, _DRAWS)


def _cases_table(figures: Sequence[Figure], cases: Sequence[Sequence[Row]]) -> Table:
    """Return a row for each case; of each scheme the first figure, the others in brackets."""
    title, *others = (figure.heading for figure in figures)
    columns = []
    for of_scheme in zip(*cases, strict=True):
        # Where cases differ in the actuator, their labels name it.
        actuators = {row["actuator"] or "" for row in of_scheme}
        columns.append(Column(of_scheme[0]["scheme"], *(actuators if len(actuators) == 1 else ())))
    table = []
    for rows in cases:
        cells = []
        for row in rows:
            first, *rest = (cell_text(row[one.name], one.column) for one in figures)
            cells.append(f"{first} ({', '.join(rest)})" if rest else first)
        table.append((case_label(rows[0]), *cells))
    heading = f"{title} ({', '.join(others)})" if others else title
    return Table(heading, [key_column("case"), *columns], table)


def _summary_table(figure: Figure, cases: Sequence[Sequence[Row]]) -> Table:
    rows = summaries(cases, [figure.name])
    titles = {name: title for name, title in _SUMMARY.items() if not rows[name].isna().all()}
    if "difference" in titles:
        titles["difference"] = f"less {rows.baseline.iloc[0]}"
    keys = ["settings"] if rows.settings.any() else []
    columns = [
        *map(key_column, (*keys, "scheme", "actuator")),
        *(Column(title, "", figure.decimals, name=name) for name, title in titles.items()),
    ]
    cells = rows[[column.name or column.title for column in columns]].to_numpy(dtype=object)
    # Cases with the same sky are no further evidence of how a scheme fares under others.
    skies = len({tuple(of_case[0].get(name) for name in _DRAWS) for of_case in cases})
    counts = f"{skies:,} {'sky' if skies == 1 else 'skies'} in {len(cases):,} cases"
    return Table(f"{figure.heading}, {counts}", columns, cells.tolist())


def summaries(
    cases: Sequence[Sequence[Row]], names: Iterable[str] = tuple(FIGURES)
) -> pd.DataFrame:
    """Summarise each figure of each scheme over the cases with the same settings and faults.

    Errors are half the width of a 95 % interval by Student's t. Only seeds are independent draws:
    for cases of which no two have different seeds, and for one case, errors are NaN. `difference`
    is the mean of the scheme less the baseline, `predictive` or else the first scheme, with the
    same actuator. `remarks` are those of the cases.
    """
    schemes = [row["scheme"] for row in cases[0]]
    baseline = "predictive" if "predictive" in schemes else schemes[0]
    keys = [(row["scheme"], row["actuator"]) for row in cases[0]]
    same = [(baseline, actuator) for _, actuator in keys]
    beside = [keys.index(key) if key in keys else schemes.index(baseline) for key in same]
    samples: dict[str, list[Sequence[Row]]] = {}
    for rows in cases:
        samples.setdefault(_settings(rows[0]), []).append(rows)
    tables = []
    for name in names:
        for settings, sample in samples.items():
            # A row for each case, a column for each scheme.
            values = pd.DataFrame([[row[name] for row in rows] for rows in sample], dtype=float)
            less = values - values[beside].to_numpy()
            less[beside] = np.nan
            is_drawn = len({rows[0].get("seed") for rows in sample}) == len(sample)
            columns = {
                "figure": name,
                "unit": FIGURES[name].unit,
                "settings": settings,
                "scheme": schemes,
                "actuator": [row["actuator"] for row in sample[0]],
                "cases": values.count(),
                "mean": values.mean(),
                "mean_error": _half_interval(values) if is_drawn else np.nan,
                "low": values.quantile(0.05),
                "median": values.median(),
                "high": values.quantile(0.95),
                "baseline": baseline,
                "difference": less.mean(),
                "difference_error": _half_interval(less) if is_drawn else np.nan,
                "remarks": " ".join(dict.fromkeys(rows[0]["remarks"] for rows in sample)),
            }
            tables.append(pd.DataFrame(columns).query("cases > 0"))
    return pd.concat(tables)


def _half_interval(values: pd.DataFrame) -> pd.Series:
    return values.sem() * stdtrit(values.count() - 1, _UPPER)
