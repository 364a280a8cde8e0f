"""Figures of the plant as a whole: what was possible, promised and delivered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from studies.report.style import (
    BLACK,
    GREY,
    SAND,
    SUPPORT,
    ReportFigure,
    dress,
    faint,
    label_time_axis,
    plain,
    scheme_line,
    share_axis,
    thinning_note,
    time_line,
)

_PANEL_PX = 230
_DASHED = {"color": BLACK, "width": 1.2, "dash": "dash"}


def possible_power(series: Sequence[RunSeries]) -> ReportFigure:
    """Draw possible power against commitment, desired and delivered power.

    Parameters
    ----------
    series
        Runs of the same plant in the same cycles, with the same desired power.
    """
    first = series[0]
    figure = go.Figure()
    possible = time_line(
        first,
        first.possible_kw,
        name="possible",
        fill="tozeroy",
        fillcolor=faint(SAND, 0.5),
        line={"color": SAND, "width": 1},
    )
    figure.add_trace(possible)
    if np.any(np.nan_to_num(first.regulation_kw)):
        desired = time_line(
            first,
            first.desired_kw,
            name="desired, with regulation",
            line={"color": GREY, "width": 1},
        )
        figure.add_trace(desired)
    for position, one in enumerate(series):
        line = scheme_line(position)
        delivered = time_line(one, one.delivered_kw, name=_delivered(one, series), line=line)
        figure.add_trace(delivered)
    figure.add_trace(time_line(first, first.commitment_kw, name="commitment", line=_DASHED))
    dress(figure, 420)
    figure.update_yaxes(title_text="plant power [kW]", rangemode="tozero")
    label_time_axis(figure, first)
    short = 100.0 * np.mean((first.possible_kw < first.desired_kw)[first.known])
    return ReportFigure(
        "possible-power",
        "Possible, committed and delivered power",
        "Power of the plant [kW]. The shaded area is what all inverters could have given at their "
        "maximum power points; the dashed line is the commitment. Possible power was below desired "
        f"power in {short:.1f} % of the cycles." + thinning_note(first.cycles),
        figure,
    )


def delivered_and_support(series: Sequence[RunSeries]) -> ReportFigure:
    """Draw delivered power and the support it needed, one panel for each run.

    Parameters
    ----------
    series
        Runs of the same plant in the same cycles. Their panels share both axes.
    """
    figure = make_subplots(
        rows=len(series),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.18 / len(series),
        subplot_titles=[plain(one.label) if len(series) > 1 else "" for one in series],
    )
    for position, one in enumerate(series):
        for trace in _panel(one, _delivered(one, series), position):
            figure.add_trace(trace, row=position + 1, col=1)
    dress(figure, 110 + _PANEL_PX * len(series))
    figure.update_yaxes(title_text="power [kW]", range=_common_range_kw(series))
    share_axis(figure, "y")
    # Above the title of the first panel.
    if len(series) > 1:
        figure.update_layout(legend_y=1.0 + 24.0 / (_PANEL_PX * len(series)), margin_t=70)
    label_time_axis(figure, series[0], rows=len(series))
    needed = "; ".join(
        f"{one.label} {np.nansum(one.support_kw) * one.cycle_s / 3600.0:,.1f} kWh" for one in series
    )
    return ReportFigure(
        "support",
        "Delivered power and the support it needed",
        "Delivered and desired power of the plant [kW], and the support power that others had to "
        f"give, max(0, desired - delivered) [kW]. Energy of the support: {needed}."
        + thinning_note(series[0].cycles),
        figure,
    )


def _common_range_kw(series: Sequence[RunSeries]) -> list[float]:
    """Return a range that holds delivered and desired power of all runs, and zero."""
    curves = [curve for one in series for curve in (one.delivered_kw, one.desired_kw)]
    least_kw = min(0.0, *(float(np.nanmin(curve)) for curve in curves))
    greatest_kw = max(float(np.nanmax(curve)) for curve in curves)
    return [least_kw, greatest_kw + 0.05 * (greatest_kw - least_kw)]


def _panel(one: RunSeries, name: str, position: int) -> list[go.Scatter]:
    # One entry in the legend is enough for what all panels have.
    in_legend = position == 0
    return [
        time_line(
            one,
            one.support_kw,
            name="support needed",
            legendgroup="support",
            fill="tozeroy",
            fillcolor=faint(SUPPORT),
            line={"color": SUPPORT, "width": 1},
            showlegend=in_legend,
        ),
        time_line(one, one.delivered_kw, name=name, line=scheme_line(position)),
        time_line(
            one,
            one.desired_kw,
            name="desired",
            legendgroup="desired",
            line=_DASHED,
            showlegend=in_legend,
        ),
    ]


def _delivered(one: RunSeries, series: Sequence[RunSeries]) -> str:
    return "delivered" if len(series) == 1 else plain(f"delivered, {one.label}")
