"""Figures of the single inverters: what each could spare or lacked, gave or was given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from studies.report.cloud_passage import inverters_by_cluster
from studies.report.decimation import COLUMNS, least_per_bucket
from studies.report.style import (
    BLACK,
    BLUE,
    SUPPORT,
    ReportFigure,
    clock_ms,
    colour_bar,
    diverging_scale,
    dress,
    label_time_axis,
    plain,
    share_vertical_axis,
    thinning_note,
    time_line,
)

_ROW_PX = 20
_GREATEST_MAP_PX = 900


def residuals(series: RunSeries) -> ReportFigure | None:
    """Draw the residual of every inverter as a heat map, and that of the worst as a line.

    Parameters
    ----------
    series
        The run.

    Returns
    -------
    ReportFigure or None
        None where the scheme has no residuals.
    """
    if np.isnan(series.residual_kw).all():
        return None
    map_px = min(_ROW_PX * max(len(series.inverters), 8), _GREATEST_MAP_PX)
    figure = make_subplots(
        rows=2,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=30.0 / (map_px + 150.0),
        row_heights=[map_px, 120],
    )
    worst_kw = np.fmin.reduce(series.residual_kw, axis=1)
    line = time_line(series, worst_kw, name="worst", line={"color": BLUE, "width": 1.2})
    figure.add_trace(_residual_map(series, map_px), row=1, col=1)
    figure.add_trace(line, row=2, col=1)
    dress(figure, map_px + 230, legend=False)
    figure.update_layout(hovermode="closest")
    figure.update_yaxes(autorange="reversed", showgrid=False, row=1, col=1)
    figure.update_yaxes(title_text="worst [kW]", row=2, col=1)
    figure.add_hline(y=0.0, line={"color": BLACK, "width": 1}, row=2, col=1)
    label_time_axis(figure, series, rows=2)
    needy = 100.0 * np.mean(worst_kw < 0.0)
    cells = " A cell shows the least residual of the cycles that it covers."
    return ReportFigure(
        "residuals",
        "Residuals of the inverters",
        "Residual of each inverter, IMPP less request [kW]: red where it cannot meet its request "
        "and needs help, blue where it has power to spare (the two sides have scales of their "
        "own); below, the least residual of all inverters [kW]. "
        f"At least one of them needed help in {needy:.1f} % of the cycles."
        + (cells if series.cycles > COLUMNS else "")
        + thinning_note(series.cycles),
        figure,
    )


def _residual_map(series: RunSeries, map_px: int) -> go.Heatmap:
    order = inverters_by_cluster(series)
    cells_kw, rows = least_per_bucket(series.residual_kw[:, order])
    cell_ms = rows * series.cycle_s * 1e3
    # But for the few largest on either side, which would leave the rest pale.
    least_kw = min(0.0, float(np.nanquantile(cells_kw, 0.005)))
    greatest_kw = max(0.0, float(np.nanquantile(cells_kw, 0.995)))
    return go.Heatmap(
        z=cells_kw.T.astype(np.float32),
        x0=clock_ms(series)[0] + cell_ms / 2.0,
        dx=cell_ms,
        y=[plain(series.inverters[position]) for position in order],
        colorscale=diverging_scale(least_kw, greatest_kw),
        zmin=least_kw,
        zmax=greatest_kw,
        colorbar=colour_bar("kW", map_px),
        hovertemplate="%{y}: %{z:,.1f} kW<extra></extra>",
    )


def help_energy(series: Sequence[RunSeries]) -> ReportFigure:
    """Draw the energy that each inverter gave above its share, and that it lacked to it.

    Parameters
    ----------
    series
        Runs of the same plant, a panel for each. The panels share both axes.
    """
    figure = make_subplots(
        rows=len(series),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.2 / len(series),
        subplot_titles=[plain(one.label) for one in series],
    )
    order = inverters_by_cluster(series[0])
    names = [plain(series[0].inverters[position]) for position in order]
    for row, one in enumerate(series, start=1):
        given_kwh, lacking_kwh = energy_beside_share(one)
        for name, energy_kwh, colour in (
            ("given above its share", given_kwh, BLUE),
            ("lacking to its share", -lacking_kwh, SUPPORT),
        ):
            bars = go.Bar(
                x=names,
                y=energy_kwh[order],
                name=name,
                legendgroup=name,
                showlegend=row == 1,
                marker={"color": colour},
                hovertemplate="%{x}: %{y:,.2f} kWh",
            )
            figure.add_trace(bars, row=row, col=1)
    panel_px = 230
    dress(figure, 130 + panel_px * len(series))
    figure.update_layout(
        barmode="relative",
        bargap=0.25,
        hovermode="closest",
        legend_y=1.0 + 24.0 / (panel_px * len(series)),
        margin_t=70,
        margin_b=80,
    )
    figure.update_xaxes(showgrid=False)
    figure.update_yaxes(title_text="energy [kWh]", zeroline=True)
    share_vertical_axis(figure)
    return ReportFigure(
        "help-energy",
        "Energy given and lacking, inverter by inverter",
        "Energy [kWh] that each inverter delivered above its share of the desired power, and by "
        "which it fell short of that share (downwards). The share is by rating, whatever the "
        "scheme asked of the inverter.",
        figure,
    )


def energy_beside_share(series: RunSeries) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Work out the energy that inverters gave above their share, and lacked to it.

    With the share :math:`S_i = P_{desired} \, c_i / \sum c` of the inverter with the rating c_i
    (eq. 3 of the paper, where ratings are equal), both summed over the run:

    .. math::

        E_{given,i} = \sum \max(0, P_i - S_i) \, dt, \quad
        E_{lacking,i} = \sum \max(0, S_i - P_i) \, dt

    Returns
    -------
    tuple of numpy.ndarray
        Energy given and lacking [kWh], each of shape (n,).
    """
    share_kw = np.outer(np.maximum(series.desired_kw, 0.0), series.rating_kw)
    share_kw /= series.rating_kw.sum()
    above_kw = series.power_kw - share_kw
    hours = series.cycle_s / 3600.0
    given_kwh = np.maximum(above_kw, 0.0).sum(axis=0) * hours
    lacking_kwh = np.maximum(-above_kw, 0.0).sum(axis=0) * hours
    return np.asarray(given_kwh), np.asarray(lacking_kwh)
