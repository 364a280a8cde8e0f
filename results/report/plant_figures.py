"""Figures of the plant: available power, commitment, dispatch and delivered power.

All take runs of the same plant in the same cycles, with the same dispatch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from results.report import style

_PANEL_PX = 230
_DASHED = {"color": style.BLACK, "width": 1.2, "dash": "dash"}
_CLOSE_LOOK_S = 600.0
_DEVIATION = "deviation [kW]"


def available_power(series: Sequence[RunSeries]) -> style.ReportFigure:
    """Draw available power against commitment, dispatch and delivered power."""
    first = series[0]
    sand, grey = {"color": style.SAND, "width": 1}, {"color": style.GREY, "width": 1}
    area = {"fill": "tozeroy", "fillcolor": style.faint(style.SAND, 0.5)}
    lines = [style.time_line(first, first.available_kw, "available", sand, **area)]
    if _asks_regulation(first):
        lines.append(style.time_line(first, first.desired_kw, "dispatch, with regulation", grey))
    lines += _delivered_lines(series)
    lines.append(style.time_line(first, first.commitment_kw, "commitment", _DASHED))
    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.68, 0.32]
    )
    figure.add_traces(lines, rows=1, cols=1)
    for position, one in enumerate(series):
        line = _deviation_line(one, style.scheme_line(position), showlegend=False)
        figure.add_trace(line, row=2, col=1)
    style.dress(figure, 560)
    figure.update_yaxes(title_text="plant power [kW]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text=_DEVIATION, row=2, col=1)
    style.label_time_axis(figure, first, rows=2)
    short = 100.0 * np.mean((first.available_kw < first.desired_kw)[first.known])
    return style.ReportFigure(
        "available-power",
        "Available, committed and delivered power",
        "Power of the plant [kW]. The shaded area is what all inverters could have given at their "
        "maximum power points; the dashed line is the commitment. Available power was below the "
        f"dispatch in {short:.1f} % of the cycles. Below is what was delivered less what was "
        "dispatched, on an axis of its own.",
        figure,
    )


def delivered_and_shortfall(series: Sequence[RunSeries]) -> style.ReportFigure:
    """Draw delivered power, and its deviation from the dispatch; the runs have the same axes."""
    count = len(series)
    titles = [style.plain(one.label) if count > 1 else "" for one in series]
    figure = make_subplots(
        rows=2 * count,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.14 / count,
        row_heights=[0.6, 0.4] * count,
        subplot_titles=[text for title in titles for text in (title, "")],
    )
    red = {"color": style.SHORTFALL, "width": 0.5}
    grey = {"color": style.GREY, "width": 0.5}
    area = {"fill": "tozeroy", "fillcolor": style.faint(style.SHORTFALL)}
    for number, (one, delivered) in enumerate(zip(series, _delivered_lines(series), strict=True)):
        # One entry in the legend is enough for what all panels have.
        once = {"showlegend": number == 0}
        dispatch = style.time_line(one, one.desired_kw, "dispatch", _DASHED, **once)
        figure.add_traces([delivered, dispatch], rows=2 * number + 1, cols=1)
        unavoidable_kw = np.maximum(one.desired_kw - one.available_kw, 0.0)
        missed = style.time_line(one, -one.shortfall_kw, "shortfall", red, **area, **once)
        filled = {"fill": "tozeroy", "fillcolor": style.faint(style.GREY, 0.8)}
        sky = style.time_line(one, -unavoidable_kw, "of it unavoidable", grey, **filled, **once)
        look = style.scheme_line(number) | {"width": 1}
        deviation = _deviation_line(one, look, showlegend=False)
        figure.add_traces([missed, sky, deviation], rows=2 * number + 2, cols=1)
    style.dress(figure, 110 + 2 * _PANEL_PX * count)
    powers_kw = [kw for one in series for kw in (one.delivered_kw, one.dispatch_kw)]
    deviations_kw = [one.delivered_kw - one.dispatch_kw for one in series]
    for number in range(count):
        row = 2 * number + 1
        figure.update_yaxes(title_text="power [kW]", rangemode="tozero", row=row, col=1)
        figure.update_yaxes(title_text=_DEVIATION, row=row + 1, col=1)
        if count > 1:  # The panels are to be compared.
            figure.update_yaxes(range=_range(powers_kw, from_zero=True), row=row, col=1)
            figure.update_yaxes(range=_range(deviations_kw), row=row + 1, col=1)
    if count > 1:  # The legend stands above the title of the first panel.
        figure.update_layout(legend_y=1.0 + 24.0 / (2 * _PANEL_PX * count), margin_t=70)
    style.label_time_axis(figure, series[0], rows=2 * count)
    energies = "; ".join(
        f"{one.label} {np.nansum(one.shortfall_kw) * one.cycle_s / 3600.0:,.1f} kWh"
        for one in series
    )
    return style.ReportFigure(
        "shortfall",
        "Delivered power and its deviation from the dispatch",
        "Delivered power and dispatch of the plant [kW]. Below, on an axis of its own, delivered "
        "less dispatch: what is below zero is the shortfall, the grey part of it unavoidable. "
        f"Energy of the shortfall: {energies}.",
        figure,
    )


def _range(values_kw: Sequence[NDArray[np.float64]], *, from_zero: bool = False) -> list[float]:
    """Return an axis that holds all values, with some room."""
    low, high = (float(find(np.concatenate(values_kw))) for find in (np.nanmin, np.nanmax))
    low = min(low, 0.0) if from_zero else low
    room = 0.05 * (high - low or 1.0)
    return [low if from_zero and low == 0.0 else low - room, high + room]


def _deviation_line(one: RunSeries, line: Mapping[str, object], **look: object) -> go.Scatter:
    deviation_kw = one.delivered_kw - one.desired_kw
    # A group of its own would put the other entries of the legend below each other.
    look |= {"legendgroup": None}
    return style.time_line(one, deviation_kw, f"deviation, {one.label}", line, **look)


def _delivered_lines(series: Sequence[RunSeries]) -> list[go.Scatter]:
    return [
        style.time_line(
            one, one.delivered_kw, _of("delivered", one, series), style.scheme_line(position)
        )
        for position, one in enumerate(series)
    ]


def _of(what: str, one: RunSeries, series: Sequence[RunSeries]) -> str:
    """Name a line of one run in the legend."""
    return what if len(series) == 1 else f"{what}, {one.label}"


def regulation(series: Sequence[RunSeries]) -> style.ReportFigure | None:
    """Draw regulation asked and given, in the whole run and in its worst ten minutes, if any."""
    first = series[0]
    if not _asks_regulation(first):
        return None
    # One that never curtails follows nothing: it would hide the others, and choose the minutes.
    curtailing = {at: one for at, one in enumerate(series) if np.any(one.power_kw < one.mpp_kw)}
    following = curtailing or dict(enumerate(series))
    worst = farthest_from_asked(list(following.values()))
    figure = make_subplots(
        rows=2,
        cols=1,
        vertical_spacing=0.16,
        subplot_titles=["whole run", f"from {style.clock_text(first, worst.start)}"],
    )
    for row, cycles in enumerate((range(first.cycles), worst), start=1):
        once = {"showlegend": row == 1}
        for position, one in following.items():
            given_kw, name = one.delivered_kw - one.commitment_kw, _of("given", one, series)
            look = style.scheme_line(position)
            given = style.time_line(one, given_kw, name, look, cycles, **once)
            figure.add_trace(given, row, 1)
        asked = style.time_line(first, first.regulation_kw, "asked", _DASHED, cycles, **once)
        figure.add_trace(asked, row, 1)
    style.dress(figure, 580)
    figure.update_layout(legend_y=1.05, margin_t=70)
    capacity_kw = first.plan.site.regulation_capacity_kw
    # A plant that lacks power falls far below: the signal would be a thin line above that.
    figure.update_yaxes(title_text="regulation [kW]", range=[-3.0 * capacity_kw, 2.0 * capacity_kw])
    style.label_time_axis(figure, first, rows=2)
    figure.update_xaxes(range=style.clock_range_ms(first, worst), row=2, col=1)
    return style.ReportFigure(
        "regulation",
        "Regulation asked and given",
        "Regulation that the signal asked for, and the regulation given: delivered power less the "
        f"commitment [kW]. A signal of 1 asks for {capacity_kw:,.0f} kW. Below are the "
        f"{len(worst) * first.cycle_s / 60.0:.3g} minutes with the largest mean distance between "
        "the two; cycles in which the plant could not have given the regulation do not count. The "
        "axis ends at three times the capacity below the commitment and twice above it.",
        figure,
    )


def farthest_from_asked(series: Sequence[RunSeries]) -> range:
    """Find the ten minutes in which regulation given was farthest from regulation asked.

    That is where the mean of |delivered - dispatch|, over the runs, is largest. Cycles in which
    nothing was asked, or in which the plant could not have given it, do not count.
    """
    first = series[0]
    length = min(max(1, round(_CLOSE_LOOK_S / first.cycle_s)), first.cycles)
    error_kw = np.mean([np.abs(one.delivered_kw - one.desired_kw) for one in series], axis=0)
    could = first.known & (first.regulation_kw != 0.0) & (first.available_kw >= first.desired_kw)
    asked = np.where(could, error_kw, 0.0)
    begin = int(np.convolve(asked, np.ones(length), mode="valid").argmax())
    return range(begin, begin + length)


def _asks_regulation(one: RunSeries) -> bool:
    return bool(np.any(np.nan_to_num(one.regulation_kw)))
