"""The figure of the delay study: what a run came to against how bad its network was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from studies.report.style import SCHEMES, ReportFigure, dress

_ROW_PX: Final = 210
_FRAME_PX: Final = 120


@dataclass(frozen=True, slots=True)
class StudyCurve:
    """One figure of merit along one trouble.

    Attributes
    ----------
    row, column
        Headings of the panel: the figure of merit, and the trouble.
    name
        What the legend calls it; curves of one name look alike in all panels.
    troubles, merits
        How bad the trouble was, and what the run came to; None where there is no figure.
    """

    row: str
    column: str
    name: str
    troubles: list[float]
    merits: list[float | None]


def study_figure(
    anchor: str, heading: str, caption: str, curves: Sequence[StudyCurve]
) -> ReportFigure:
    """Draw a panel for each figure of merit and each trouble.

    The troubles stand in even steps, whatever their values: from nothing to very bad.

    Parameters
    ----------
    anchor, heading, caption
        See `ReportFigure`.
    curves
        What to draw.
    """
    rows = list(dict.fromkeys(curve.row for curve in curves))
    columns = list(dict.fromkeys(curve.column for curve in curves))
    names = list(dict.fromkeys(curve.name for curve in curves))
    figure = make_subplots(
        len(rows), len(columns), shared_yaxes=True, vertical_spacing=0.05, horizontal_spacing=0.03
    )
    shown: set[str] = set()
    for curve in curves:
        row, column = rows.index(curve.row) + 1, columns.index(curve.column) + 1
        figure.add_trace(
            _trace(curve, names.index(curve.name), in_legend=curve.name not in shown), row, column
        )
        shown.add(curve.name)
        figure.update_xaxes(
            row=row,
            col=column,
            tickvals=list(range(len(curve.troubles))),
            ticktext=[f"{value:g}" for value in curve.troubles],
            title_text=curve.column if row == len(rows) else None,
        )
        figure.update_yaxes(row=row, col=1, title_text=curve.row)
    figure = dress(figure, _FRAME_PX + _ROW_PX * len(rows))
    figure.update_layout(hovermode="closest")
    return ReportFigure(anchor, heading, caption, figure)


def _trace(curve: StudyCurve, place: int, *, in_legend: bool) -> go.Scatter:
    colour = SCHEMES[place % len(SCHEMES)]
    return go.Scatter(
        x=list(range(len(curve.troubles))),
        y=curve.merits,
        name=curve.name,
        legendgroup=curve.name,
        showlegend=in_legend,
        mode="lines+markers",
        line={"color": colour, "width": 1.6},
        marker={"color": colour, "size": 5},
        customdata=curve.troubles,
        hovertemplate="%{customdata:g}: %{y:.4g}<extra>" + curve.name + "</extra>",
    )
