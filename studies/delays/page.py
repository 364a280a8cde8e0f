"""The study of delay and loss as one HTML page, with its figure."""

from __future__ import annotations

from collections.abc import Sequence
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

_DRAWN: Final = ("control-caused", "over-delivered", "mileage", "regd", "score")
_CAPTION: Final = (
    "Along each panel one thing is worse than in the scenario, in even steps from nothing to very "
    "bad; everything else is perfect."
)
_ROW_PX: Final = 240
_FRAME_PX: Final = 120


def study_page(preparation: Preparation, outcomes: Sequence[Outcome]) -> str:
    """Return the page: the figure, and a table for each trouble."""
    title = f"{study_title(preparation)}: delay, loss and a slow central controller"
    notes = [*study_notes(preparation), *survived(outcomes)]
    tables = [trouble_table(trouble, outcomes) for trouble in VALUES]
    return html_page(title, notes, [_study_figure(outcomes), *tables])


def _study_figure(outcomes: Sequence[Outcome]) -> ReportFigure:
    """Draw a panel for each figure of merit and each trouble, in even steps of the trouble."""
    figure = make_subplots(
        len(_DRAWN),
        len(TROUBLES),
        shared_yaxes=True,
        vertical_spacing=0.05,
        horizontal_spacing=0.03,
    )
    for row, merit in enumerate(_DRAWN, start=1):
        for column, (trouble, (_, measure, unit)) in enumerate(TROUBLES.items(), start=1):
            for colour, scheme in zip(SCHEMES, get_args(Scheme), strict=False):
                found = column_of(outcomes, trouble, scheme)
                trace = go.Scatter(
                    x=list(range(len(found))),
                    y=[one.figures[merit] for one in found],
                    name=scheme,
                    legendgroup=scheme,
                    showlegend=row == column == 1,
                    mode="lines+markers",
                    line={"color": colour, "width": 1.6},
                    marker={"color": colour, "size": 5},
                    customdata=[one.value for one in found],
                    hovertemplate="%{customdata:g}: %{y:.4g}<extra>" + scheme + "</extra>",
                )
                figure.add_trace(trace, row, column)
            figure.update_xaxes(
                row=row,
                col=column,
                tickvals=list(range(len(found))),
                ticktext=[f"{one.value:g}" for one in found],
                title_text=f"{measure} [{unit}]" if row == len(_DRAWN) else None,
            )
        figure.update_yaxes(row=row, col=1, title_text=FIGURES_OF_MERIT[merit].heading)
    figure = dress(figure, _FRAME_PX + _ROW_PX * len(_DRAWN))
    return ReportFigure("study", "What each trouble costs", _CAPTION, figure)
