"""The tables of a comparison, in the terminal and as rows for other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import Final

from rich.table import Table

from studies.compare.study import CaseResult, SchemeResult
from studies.metrics import RunMetrics

Figure = Callable[[RunMetrics], float | None]

FIGURES: Final[dict[str, tuple[str, Figure]]] = {
    "satisfied": ("% of desired", lambda m: m.commitment.satisfied_percent),
    "unsatisfied": (
        "% of desired",
        lambda m: m.commitment.percent(m.commitment.unsatisfied_kwh),
    ),
    "unavoidable": (
        "% of desired",
        lambda m: m.commitment.percent(m.commitment.unavoidable_kwh),
    ),
    "control-caused": (
        "% of desired",
        lambda m: m.commitment.percent(m.commitment.control_caused_kwh),
    ),
    "over-delivered": (
        "% of desired",
        lambda m: m.commitment.percent(m.commitment.over_delivered_kwh),
    ),
    "rmse": ("kW", lambda m: m.tracking.rmse_kw),
    "mae": ("kW", lambda m: m.tracking.mae_kw),
    "mileage": ("kW per hour", lambda m: m.support.per_hour_kw),
    "ramp": (
        "largest, kW per minute",
        lambda m: (
            max(m.ramps.largest_up_kw_per_min, m.ramps.largest_down_kw_per_min) if m.ramps else None
        ),
    ),
    "above-ramp-limit": (
        "% of minutes",
        lambda m: m.ramps.above_limit_percent if m.ramps else None,
    ),
    "regd": (
        "% of requests fulfilled at 1 % of rating",
        lambda m: m.regulation.requests[-1].fulfilled_percent if m.regulation else None,
    ),
    "score": (
        "PJM performance score, 0 to 1",
        lambda m: (
            m.regulation.performance.score if m.regulation and m.regulation.performance else None
        ),
    ),
}
"""Figures that a study can be shown by: name, unit, and where it is found."""


def commitment_table(title: str, schemes: Sequence[SchemeResult]) -> Table:
    """Return the paper's first table and what it leaves out, a row a scheme."""
    table = Table(title=title, title_justify="left")
    table.add_column("scheme", no_wrap=True)
    for heading in (
        "satis-\nfied %",
        "missing\nkWh",
        "unavoid-\nable %",
        "control-\ncaused %",
        "over-de-\nlivered %",
        "mileage\nkW/h",
        "RMSE\nkW",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for entry in schemes:
        energy = entry.metrics.commitment
        table.add_row(
            entry.scheme,
            _text(energy.satisfied_percent),
            f"{energy.unsatisfied_kwh:,.1f}",
            _text(energy.percent(energy.unavoidable_kwh)),
            _text(energy.percent(energy.control_caused_kwh)),
            _text(energy.percent(energy.over_delivered_kwh), 2),
            f"{entry.metrics.support.per_hour_kw:,.0f}",
            f"{entry.metrics.tracking.rmse_kw:,.1f}",
        )
    return table


def regulation_table(schemes: Sequence[SchemeResult]) -> Table | None:
    """Return the paper's second table, and PJM's score beside it; None without regulation."""
    followed = [(entry.scheme, entry.metrics.regulation) for entry in schemes]
    if not any(regulation for _, regulation in followed):
        return None
    table = Table(title="Regulation signal", title_justify="left")
    table.add_column("scheme", no_wrap=True)
    for heading in (
        "fulfilled\nat 0.1 %",
        "fulfilled\nat 1 %",
        "accuracy",
        "delay",
        "precision",
        "score",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for scheme, regulation in followed:
        if regulation is None:
            continue
        score = regulation.performance
        parts = (
            (score.accuracy, score.delay, score.precision, score.score) if score else (None,) * 4
        )
        table.add_row(
            scheme,
            *(f"{request.fulfilled_percent:.2f} %" for request in regulation.requests[:2]),
            *(_text(part) for part in parts),
        )
    return table


def pivot_table(figure: str, results: Sequence[CaseResult]) -> Table:
    """Return one figure of many cases: a row a case, a column a scheme."""
    unit, read = FIGURES[figure]
    table = Table(title=f"{figure}, {unit}", title_justify="left")
    table.add_column("case")
    for name in _scheme_names(results):
        table.add_column(name.replace(" ", "\n"), justify="right", no_wrap=True)
    for result in results:
        table.add_row(result.label, *_values(result, read))
    return table


def summary_table(figure: str, results: Sequence[CaseResult]) -> Table:
    """Return the mean and the extremes of one figure over many cases, a row a scheme."""
    unit, read = FIGURES[figure]
    table = Table(title=f"{figure}, {unit}, {len(results):,} cases", title_justify="left")
    for heading in ("scheme", "mean", "least", "most"):
        table.add_column(heading, justify="left" if heading == "scheme" else "right")
    for place, name in enumerate(_scheme_names(results)):
        values = [read(result.schemes[place].metrics) for result in results]
        known = [value for value in values if value is not None]
        if known:
            table.add_row(name, *(_text(value) for value in (fmean(known), min(known), max(known))))
    return table


def rows(results: Sequence[CaseResult]) -> list[dict[str, object]]:
    """Return a row for each case and scheme: the figures, all metrics, and what was mended."""
    return [
        {
            "case": result.label,
            "scheme": entry.scheme,
            **{name: read(entry.metrics) for name, (_, read) in FIGURES.items()},
            "metrics": entry.metrics,
            "remarks": result.remarks,
        }
        for result in results
        for entry in result.schemes
    ]


def _scheme_names(results: Sequence[CaseResult]) -> list[str]:
    return [entry.scheme for entry in results[0].schemes]


def _values(result: CaseResult, read: Figure) -> list[str]:
    return [_text(read(entry.metrics)) for entry in result.schemes]


def _text(value: float | None, decimals: int = 3) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"
