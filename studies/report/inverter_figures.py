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
    list_names,
    name_px,
    plain,
    scheme_title,
    share_axis,
    thinning_note,
    time_line,
)

_LEAST_MAP_PX = 160
_TITLE_PX = 44


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
    count = len(series.inverters)
    map_px = max(count * name_px(count), _LEAST_MAP_PX)
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
    list_names(figure, count, row=1, col=1)
    figure.update_yaxes(title_text="worst [kW]", row=2, col=1)
    figure.add_hline(y=0.0, line={"color": BLACK, "width": 1}, row=2, col=1)
    label_time_axis(figure, series, rows=2)
    needy = 100.0 * np.mean(worst_kw[np.isfinite(worst_kw)] < 0.0)
    cells = " Each cell shows the least residual of the cycles that it covers."
    return ReportFigure(
        "residuals",
        "Residuals of the inverters",
        "Residual of each inverter, IMPP less request [kW]. Red: it cannot meet its request and "
        "needs help. Blue: it has headroom. The two sides have scales of their own. The line below "
        "is the least residual of all inverters [kW]. "
        f"At least one inverter needed help in {needy:.1f} % of the cycles."
        + (cells if series.cycles > COLUMNS else "")
        + thinning_note(series.cycles),
        figure,
    )


def _residual_map(series: RunSeries, map_px: int) -> go.Heatmap:
    order = inverters_by_cluster(series)
    cells_kw, rows = least_per_bucket(series.residual_kw[:, order])
    cell_ms = rows * series.cycle_s * 1e3
    # Without the few largest on either side, which would leave the rest pale.
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
    """Draw the energy that each inverter gave above its share, and by which it fell short of it.

    Parameters
    ----------
    series
        Runs of the same plant, a panel for each. The panels share both axes.
    """
    order = inverters_by_cluster(series[0])
    names = [plain(series[0].inverters[position]) for position in order]
    figure = make_subplots(
        rows=1,
        cols=len(series),
        shared_yaxes=True,
        horizontal_spacing=0.03,
        subplot_titles=[scheme_title(one.label, len(series)) for one in series],
    )
    for column, one in enumerate(series, start=1):
        given_kwh, lacking_kwh = energy_beside_share(one)
        for name, energy_kwh, colour in (
            ("above its share", given_kwh, BLUE),
            ("below its share", -lacking_kwh, SUPPORT),
        ):
            bars = go.Bar(
                y=names,
                x=energy_kwh[order],
                orientation="h",
                name=name,
                legendgroup=name,
                showlegend=column == 1,
                marker={"color": colour},
                hovertemplate="%{y}: %{x:,.2f} kWh",
            )
            figure.add_trace(bars, row=1, col=column)
    plot_px = max(len(names) * name_px(len(names)), _LEAST_MAP_PX)
    dress(figure, plot_px + 140)
    figure.update_layout(
        barmode="relative",
        bargap=0.25,
        hovermode="closest",
        legend_y=1.0 + (_TITLE_PX / plot_px if len(series) > 1 else 0.0),
        margin_t=90 if len(series) > 1 else 46,
    )
    list_names(figure, len(names))
    figure.update_xaxes(title_text="energy [kWh]", zeroline=True)
    share_axis(figure, "x")
    return ReportFigure(
        "help-energy",
        "Energy above and below the share, inverter by inverter",
        "Energy [kWh] that each inverter delivered above its share of the desired power (to the "
        "right), and by which it fell short of that share (to the left). The share is by rating, "
        "whatever the scheme asked of the inverter.",
        figure,
    )


def energy_beside_share(series: RunSeries) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Work out the energy above each inverter's share, and by which it fell short of that.

    With the share :math:`S_i = P_{desired} \, c_i / \sum c` of the inverter with the rating c_i
    (eq. 3 of the paper, where ratings are equal), both summed over the run:

    .. math::

        E_{given,i} = \sum \max(0, P_i - S_i) \, dt, \quad
        E_{lacking,i} = \sum \max(0, S_i - P_i) \, dt

    Returns
    -------
    tuple of numpy.ndarray
        Energy above and below the share [kWh], each of shape (n,).
    """
    share_kw = np.outer(np.maximum(series.desired_kw, 0.0), series.rating_kw)
    share_kw /= series.rating_kw.sum()
    above_kw = series.power_kw - share_kw
    hours = series.cycle_s / 3600.0
    given_kwh = np.nansum(np.maximum(above_kw, 0.0), axis=0) * hours
    lacking_kwh = np.nansum(np.maximum(-above_kw, 0.0), axis=0) * hours
    return np.asarray(given_kwh), np.asarray(lacking_kwh)
