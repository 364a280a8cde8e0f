"""The tables of a comparison, and its rows for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import Final

from studies.compare.study import CaseResult, SchemeResult
from studies.metrics.figures_of_merit import (
    FIGURES_OF_MERIT,
    FigureOfMerit,
    figures_json,
    runs_as_rows,
    shown_in,
)
from studies.tables import Cell, Column, Table, key_column

_LISTED: Final = 40
"""Up to this many cases have a row each; of more, the mean and the extremes are shown."""


def case_tables(title: str, schemes: Sequence[SchemeResult]) -> list[Table]:
    """Return the paper's tables for one case, a row for each scheme."""
    runs = [(entry.scheme, entry.metrics) for entry in schemes]
    tables = [runs_as_rows(title, runs, shown_in("compare", "commitment"))]
    followed = [(name, metrics) for name, metrics in runs if metrics.regulation]
    if followed:
        figures = shown_in("compare", "regulation")
        tables.append(runs_as_rows("Regulation signal", followed, figures))
    return tables


def cases_table(name: str, results: Sequence[CaseResult]) -> Table:
    """Return one figure of merit of many cases."""
    figure = FIGURES_OF_MERIT[name]
    if len(results) > _LISTED:
        return _summary(figure, results)
    schemes = [entry.scheme for entry in results[0].schemes]
    columns = (key_column("case"), *(Column(scheme, "", figure.decimals) for scheme in schemes))
    rows = tuple(
        (result.label, *(figure.read(entry.metrics) for entry in result.schemes))
        for result in results
    )
    return Table(figure.heading, columns, rows)


def _summary(figure: FigureOfMerit, results: Sequence[CaseResult]) -> Table:
    statistics = (("mean", fmean), ("least", min), ("most", max))
    rows: list[tuple[Cell, ...]] = []
    for place, entry in enumerate(results[0].schemes):
        values = [figure.read(result.schemes[place].metrics) for result in results]
        known = [value for value in values if value is not None]
        if known:
            rows.append((entry.scheme, *(of_many(known) for _, of_many in statistics)))
    columns = (
        key_column("scheme"),
        *(Column(title, "", figure.decimals) for title, _ in statistics),
    )
    return Table(f"{figure.heading}, {len(results):,} cases", columns, tuple(rows))


def json_rows(results: Sequence[CaseResult]) -> list[dict[str, object]]:
    """Return a row for each case and scheme: all figures of merit, all metrics, remarks."""
    return [
        {
            "case": result.label,
            "scheme": entry.scheme,
            **figures_json(entry.metrics),
            "metrics": entry.metrics,
            "remarks": result.remarks,
        }
        for result in results
        for entry in result.schemes
    ]
