"""Figures of the plant: available power, commitment, dispatch and delivered power.

All take runs of the same plant in the same cycles, with the same dispatch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from results.report import style

_DASHED = {"color": style.BLACK, "width": 1.2, "dash": "dash"}
_DOTTED = {"color": style.BLACK, "width": 1.0, "dash": "dot"}
_ALONE = {"color": style.ORANGE, "width": 1.2}
_UNLISTED = {"showlegend": False}


def plant_power(series: Sequence[RunSeries]) -> style.ReportFigure:
    """Draw available, dispatched and delivered power; below, the deviation from the dispatch.

    A single run has its baseline beside it: the same sky without help between inverters.
    """
    first = series[0]
    sand, grey = {"color": style.SAND, "width": 1}, {"color": style.GREY, "width": 0.5}
    area = {"fill": "tozeroy", "fillcolor": style.faint(style.SAND, 0.5)}
    powers = [style.time_line(first, first.available_kw, "available", sand, **area)]
    unavoidable_kw = np.minimum(first.available_kw - first.desired_kw, 0.0)
    shaded = {"fill": "tozeroy", "fillcolor": style.faint(style.GREY, 0.8)}
    deviations = [style.time_line(first, unavoidable_kw, "denied by the sky", grey, **shaded)]
    if len(series) == 1 and np.isfinite(first.without_help_kw).any():
        alone_kw = first.without_help_kw
        powers.append(style.time_line(first, alone_kw, "delivered without help", _ALONE))
        below_kw = alone_kw - first.desired_kw
        deviations.append(
            style.time_line(first, below_kw, "deviation without help", _ALONE, **_UNLISTED)
        )
    for position, one in enumerate(series):
        look = style.scheme_line(position)
        powers.append(style.time_line(one, one.delivered_kw, _of("delivered", one, series), look))
        off_kw = one.delivered_kw - one.desired_kw
        name = _of("deviation", one, series)
        deviations.append(style.time_line(one, off_kw, name, look, **_UNLISTED))
    powers.append(style.time_line(first, first.desired_kw, "dispatch", _DASHED))
    if _asks_regulation(first):
        powers.append(style.time_line(first, first.commitment_kw, "commitment", _DOTTED))
    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.6, 0.4]
    )
    figure.add_traces(powers, rows=1, cols=1)
    figure.add_traces(deviations, rows=2, cols=1)
    style.dress(figure, 430)
    figure.update_yaxes(title_text="plant power [kW]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="deviation [kW]", row=2, col=1)
    style.label_time_axis(figure, first, rows=2)
    short = 100.0 * np.mean((first.available_kw < first.desired_kw)[first.known])
    return style.ReportFigure(
        "power",
        "Power of the plant",
        "The shaded area is what the plant could have fed in, the dashed line what was asked. "
        "Below, on an axis of its own: delivered less dispatched power. Grey is what the sky "
        f"denied, in {short:.1f} % of the cycles; no controller could have given it.",
        figure,
    )


def _of(what: str, one: RunSeries, series: Sequence[RunSeries]) -> str:
    """Name a line of one run in the legend."""
    return what if len(series) == 1 else f"{what}, {one.label}"


def regulation(series: Sequence[RunSeries]) -> style.ReportFigure | None:
    """Draw regulation asked and given, if any."""
    first = series[0]
    if not _asks_regulation(first):
        return None
    # One that never curtails follows nothing: it would hide the others.
    curtailing = {at: one for at, one in enumerate(series) if np.any(one.power_kw < one.mpp_kw)}
    lines = [
        style.time_line(
            one,
            one.delivered_kw - one.commitment_kw,
            _of("given", one, series),
            style.scheme_line(position),
        )
        for position, one in (curtailing or dict(enumerate(series))).items()
    ]
    lines.append(style.time_line(first, first.regulation_kw, "asked", _DASHED))
    figure = style.dress(go.Figure(lines), 320)
    capacity_kw = first.plan.site.regulation_capacity_kw
    # A plant that lacks power falls far below: the signal would be a thin line above that.
    figure.update_yaxes(title_text="regulation [kW]", range=[-3.0 * capacity_kw, 2.0 * capacity_kw])
    style.label_time_axis(figure, first)
    return style.ReportFigure(
        "regulation",
        "Regulation asked and given",
        "Regulation that the signal asked for, and the regulation given: delivered power less the "
        f"commitment [kW]. A signal of 1 asks for {capacity_kw:,.0f} kW. The axis ends at three "
        "times the capacity below the commitment and twice above it.",
        figure,
    )


def storage(one: RunSeries) -> style.ReportFigure:
    """Draw what each storage gave and took, and below its state."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for place, settings in enumerate(one.plan.storages):
        look = style.scheme_line(place)
        power_kw, energy_kwh = one.storage_power_kw[:, place], one.storage_energy_kwh[:, place]
        states = 100.0 * energy_kwh / settings.capacity_kwh
        figure.add_trace(style.time_line(one, power_kw, settings.path, look), row=1, col=1)
        below = style.time_line(one, states, f"{settings.path}, state", look, **_UNLISTED)
        figure.add_trace(below, row=2, col=1)
    style.dress(figure, 430)
    figure.update_yaxes(title_text="power [kW]", row=1, col=1)
    figure.update_yaxes(title_text="state [%]", range=[0.0, 100.0], row=2, col=1)
    style.label_time_axis(figure, one, rows=2)
    return style.ReportFigure(
        "storage",
        "Storage",
        "What each storage gave, below 0 what it took [kW], and what was stored in it, in % of its "
        "capacity.",
        figure,
    )


def _asks_regulation(one: RunSeries) -> bool:
    return bool(np.any(np.nan_to_num(one.regulation_kw)))
