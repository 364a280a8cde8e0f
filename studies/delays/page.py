"""The study of delay and loss as one HTML page, with its figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, get_args

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from agents.plan import Scheme
from launch_scripts.scenarios.preparation import Preparation
from studies.delays.study import VALUES, Outcome
from studies.delays.tables import (
    TROUBLES,
    column_of,
    study_notes,
    study_title,
    survived,
    trouble_table,
)
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT
from studies.report.page import html_page
from studies.report.style import SCHEMES, ReportFigure, dress

_DRAWN: Final = ("control-caused", "mileage", "regd", "score")
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; everything else is perfect."
)
_ROW_PX: Final = 210
_FRAME_PX: Final = 120


@dataclass(frozen=True, slots=True)
class StudyCurve:
    """One figure of merit along one trouble, for one scheme.

    Attributes
    ----------
    figure, trouble
        Name of the figure of merit, and the heading of the trouble.
    values, merits
        How bad the trouble was, and the figure of merit, None where it is not defined.
    """

    figure: str
    trouble: str
    scheme: str
    values: list[float]
    merits: list[float | None]


def study_page(preparation: Preparation, outcomes: Sequence[Outcome]) -> str:
    """Return the page: the figure, and a table for each trouble."""
    title = f"{study_title(preparation)}: delay, loss and a slow central controller"
    figure = study_figure(study_curves(outcomes))
    notes = [*study_notes(preparation), *survived(outcomes)]
    tables = [trouble_table(trouble, outcomes) for trouble in VALUES]
    return html_page(title, notes, [figure, *tables])


def study_curves(outcomes: Sequence[Outcome]) -> list[StudyCurve]:
    """Return a curve for each figure of merit that is drawn, each trouble and each scheme."""
    curves = []
    for name in _DRAWN:
        for trouble, (_, measure, unit) in TROUBLES.items():
            for scheme in get_args(Scheme):
                column = column_of(outcomes, trouble, scheme)
                values = [one.value for one in column]
                merits = [one.figures[name] for one in column]
                curves.append(StudyCurve(name, f"{measure} [{unit}]", scheme, values, merits))
    return curves


def study_figure(curves: Sequence[StudyCurve]) -> ReportFigure:
    """Draw a panel for each figure of merit and each trouble.

    The values of a trouble stand in even steps, from nothing to very bad.
    """
    rows = list(dict.fromkeys(curve.figure for curve in curves))
    columns = list(dict.fromkeys(curve.trouble for curve in curves))
    schemes = list(dict.fromkeys(curve.scheme for curve in curves))
    figure = make_subplots(
        len(rows), len(columns), shared_yaxes=True, vertical_spacing=0.05, horizontal_spacing=0.03
    )
    for curve in curves:
        row, column = rows.index(curve.figure) + 1, columns.index(curve.trouble) + 1
        colour = SCHEMES[schemes.index(curve.scheme) % len(SCHEMES)]
        figure.add_trace(_trace(curve, colour, in_legend=row == column == 1), row, column)
        figure.update_xaxes(
            row=row,
            col=column,
            tickvals=list(range(len(curve.values))),
            ticktext=[f"{value:g}" for value in curve.values],
            title_text=curve.trouble if row == len(rows) else None,
        )
        figure.update_yaxes(row=row, col=1, title_text=FIGURES_OF_MERIT[curve.figure].heading)
    figure = dress(figure, _FRAME_PX + _ROW_PX * len(rows))
    return ReportFigure("study", "What each trouble costs", _CAPTION, figure)


def _trace(curve: StudyCurve, colour: str, *, in_legend: bool) -> go.Scatter:
    return go.Scatter(
        x=list(range(len(curve.values))),
        y=curve.merits,
        name=curve.scheme,
        legendgroup=curve.scheme,
        showlegend=in_legend,
        mode="lines+markers",
        line={"color": colour, "width": 1.6},
        marker={"color": colour, "size": 5},
        customdata=curve.values,
        hovertemplate="%{customdata:g}: %{y:.4g}<extra>" + curve.scheme + "</extra>",
    )
