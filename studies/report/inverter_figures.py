"""Figures of the inverters: their residuals, and who helped whom."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import accumulate
from typing import Final

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from studies.report import style
from studies.report.cloud_passage import (
    clusters,
    correlation_by_hour,
    find_cloud_passage,
    inverters_by_cluster,
)
from studies.report.decimation import COLUMNS, least_per_bucket

_LEAST_MAP_PX: Final = 160
_TITLE_PX: Final = 44

_ACROSS: Final = 5
_MATRIX_PX: Final = {1: 420, 2: 340, 3: 240}
"""Side of a matrix by how many stand beside each other."""
_SMALLEST_MATRIX_PX: Final = 178
_NAME_PX: Final = 14


def residuals(series: RunSeries) -> style.ReportFigure:
    """Draw the residual of every inverter as a heat map, and that of the worst as a line."""
    count = len(series.inverters)
    map_px = max(count * style.name_px(count), _LEAST_MAP_PX)
    figure = make_subplots(
        rows=2,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=30.0 / (map_px + 150.0),
        row_heights=[map_px, 120],
    )
    order = inverters_by_cluster(series)
    cells_kw, rows = least_per_bucket(series.residual_kw[:, order])
    cell_ms = rows * series.cycle_s * 1e3
    # Without the few largest on either side, which would leave the rest pale.
    least_kw = min(0.0, float(np.nanquantile(cells_kw, 0.005)))
    greatest_kw = max(0.0, float(np.nanquantile(cells_kw, 0.995)))
    figure.add_heatmap(
        z=cells_kw.T.astype(np.float32),
        x0=style.clock_ms(series)[0] + cell_ms / 2.0,
        dx=cell_ms,
        y=[style.plain(series.inverters[position]) for position in order],
        colorscale=style.diverging_scale(least_kw, greatest_kw),
        zmin=least_kw,
        zmax=greatest_kw,
        colorbar=style.colour_bar("kW", map_px),
        hovertemplate="%{y}: %{z:,.1f} kW<extra></extra>",
        row=1,
        col=1,
    )
    worst_kw = np.fmin.reduce(series.residual_kw, axis=1)
    blue = {"color": style.BLUE, "width": 1.2}
    figure.add_trace(style.time_line(series, worst_kw, "worst", blue), row=2, col=1)
    style.dress(figure, map_px + 230, legend=False)
    style.list_names(figure, count, row=1, col=1)
    figure.update_yaxes(title_text="worst [kW]", row=2, col=1)
    figure.add_hline(y=0.0, line={"color": style.BLACK, "width": 1}, row=2, col=1)
    style.label_time_axis(figure, series, rows=2)
    figure.update_layout(hovermode="closest")
    needy = 100.0 * np.mean(worst_kw[np.isfinite(worst_kw)] < 0.0)
    cells = " Each cell shows the least residual of the cycles that it covers."
    return style.ReportFigure(
        "residuals",
        "Residuals of the inverters",
        "Residual of each inverter, IMPP less request [kW]. Red: it cannot meet its request and "
        "needs help. Blue: it has headroom. The two sides have scales of their own. The line below "
        "is the least residual of all inverters [kW]. "
        f"At least one inverter needed help in {needy:.1f} % of the cycles."
        + (cells if series.cycles > COLUMNS else "")
        + style.thinning_note(series.cycles),
        figure,
    )


def help_energy(series: Sequence[RunSeries]) -> style.ReportFigure:
    """Draw the energy that each inverter gave above its share, and by which it fell short of it.

    Each run has a panel; the panels share both axes.
    """
    order = inverters_by_cluster(series[0])
    names = [style.plain(series[0].inverters[position]) for position in order]
    several = len(series) > 1
    # Titles beside each other, in lines that fit.
    width = max(10, 72 // len(series))
    titles = [
        map(style.plain, textwrap.wrap(one.label, width) if several else ()) for one in series
    ]
    figure = make_subplots(
        rows=1,
        cols=len(series),
        shared_yaxes=True,
        horizontal_spacing=0.03,
        subplot_titles=["<br>".join(lines) for lines in titles],
    )
    for column, one in enumerate(series, start=1):
        given_kwh, lacking_kwh = energy_beside_share(one)
        for name, energy_kwh, colour in (
            ("above its share", given_kwh, style.BLUE),
            ("below its share", -lacking_kwh, style.SUPPORT),
        ):
            figure.add_bar(
                y=names,
                x=energy_kwh[order],
                orientation="h",
                name=name,
                legendgroup=name,
                showlegend=column == 1,
                marker={"color": colour},
                hovertemplate="%{y}: %{x:,.2f} kWh",
                row=1,
                col=column,
            )
    plot_px = max(len(names) * style.name_px(len(names)), _LEAST_MAP_PX)
    style.dress(figure, plot_px + 140)
    figure.update_layout(
        barmode="relative",
        bargap=0.25,
        legend_y=1.0 + (_TITLE_PX / plot_px if several else 0.0),
        margin_t=90 if several else 46,
    )
    style.list_names(figure, len(names))
    figure.update_xaxes(title_text="energy [kWh]", zeroline=True)
    figure.update_xaxes(matches="x")
    return style.ReportFigure(
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

    Both are of shape (n,) [kWh].
    """
    share_kw = np.outer(np.maximum(series.desired_kw, 0.0), series.rating_kw)
    share_kw /= series.rating_kw.sum()
    above_kw = series.power_kw - share_kw
    hours = series.cycle_s / 3600.0
    given_kwh = np.nansum(np.maximum(above_kw, 0.0), axis=0) * hours
    lacking_kwh = np.nansum(np.maximum(-above_kw, 0.0), axis=0) * hours
    return np.asarray(given_kwh), np.asarray(lacking_kwh)


def virtual_neighbours(series: RunSeries) -> style.ReportFigure | None:
    """Draw IMPP and returned alpha of two virtual neighbours around a cloud passage, if any."""
    passage = find_cloud_passage(series)
    if passage is None:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    for inverter, colour in ((passage.shaded, style.ORANGE), (passage.helping, style.BLUE)):
        shown = series.inverters[inverter], {"color": colour, "width": 2}, passage.cycles
        impp = style.time_line(series, series.impp_kw[:, inverter], *shown)
        of_alpha = {"showlegend": False, "hovertemplate": "%{y:.3f}"}
        alpha = style.time_line(series, series.alpha[:, inverter], *shown, **of_alpha)
        figure.add_trace(impp, row=1, col=1)
        figure.add_trace(alpha, row=2, col=1)
    # The request made of the two, as one line where it is the same of both.
    pair = [passage.shaded, passage.helping]
    same = series.rating_kw[pair[0]] == series.rating_kw[pair[1]]
    request_kw = series.impp_kw - series.residual_kw
    for inverter, dash in zip(pair[:1] if same else pair, ("dash", "dot"), strict=False):
        name = "request" if same else f"request of {series.inverters[inverter]}"
        line = {"color": style.BLACK, "width": 1.2, "dash": dash}
        request = style.time_line(series, request_kw[:, inverter], name, line, passage.cycles)
        figure.add_trace(request, row=1, col=1)
    style.dress(figure, 520)
    figure.update_yaxes(title_text="IMPP [kW]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="alpha, power / IMPP", range=[0.0, 1.05], row=2, col=1)
    style.label_time_axis(figure, series, rows=2)
    figure.update_xaxes(range=style.clock_range_ms(series, passage.cycles))
    shaded, helping = series.inverters[passage.shaded], series.inverters[passage.helping]
    moment = style.clock_text(series, passage.bottom)
    return style.ReportFigure(
        "neighbours",
        "Two virtual neighbours under a cloud",
        f"Above: IMPP, the estimated maximum power of two inverters, and their request [kW]. "
        f"Below: their curtailment level alpha (no unit). The IMPP of {shaded} falls by "
        f"{passage.drop_kw:,.0f} kW within a minute, until {moment}, "
        f"while {helping} has headroom. The figure shows the largest such drop among the least "
        f"correlated pairs of each cluster and hour; this pair has {passage.correlation:+.2f}.",
        figure,
    )


def correlation_matrices(series: RunSeries) -> style.ReportFigure | None:
    """Draw the correlation matrix of the inverters' maximum power in each local hour.

    None where no inverter's power varied in any hour.
    """
    matrices = correlation_by_hour(series)
    if not matrices:
        return None
    order = inverters_by_cluster(series)
    names = [style.plain(series.inverters[position]) for position in order]
    midnight = series.times[0].tz_localize(None).normalize()
    hours = [midnight + pd.Timedelta(hours=hour) for hour in matrices]
    across = min(_ACROSS, len(matrices))
    rows = -(-len(matrices) // across)
    matrix_px = _MATRIX_PX.get(across, _SMALLEST_MATRIX_PX)
    height_px = rows * matrix_px
    figure = make_subplots(
        rows=rows,
        cols=across,
        horizontal_spacing=0.02,
        vertical_spacing=30.0 / height_px,
        subplot_titles=[f"{hour.day} {hour:%b}, {hour.hour} h" for hour in hours],
    )
    for place, matrix in enumerate(matrices.values()):
        row, column = place // across + 1, place % across + 1
        figure.add_heatmap(
            z=matrix[np.ix_(order, order)].astype(np.float32),
            x=names,
            y=names,
            coloraxis="coloraxis",
            hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>",
            row=row,
            col=column,
        )
        _mark_clusters(figure, series, row, column, matrix_px)
    style.dress(figure, height_px + 60, legend=False)
    # All matrices are squares without ticks, at the top of their place, below their titles.
    figure.update_xaxes(showticklabels=False, ticks="", showgrid=False, constrain="domain")
    figure.update_yaxes(ticks="", showgrid=False, autorange="reversed")
    figure.update_yaxes(constrain="domain", constraintoward="top")
    for axis in figure.select_yaxes():
        axis.scaleanchor = axis.plotly_name.replace("axis", "").replace("y", "x", 1)
    figure.update_layout(
        margin={"b": 20, "t": 40},
        coloraxis={
            "colorscale": style.diverging_scale(-1.0, 1.0),
            "cmin": -1.0,
            "cmax": 1.0,
            "colorbar": style.colour_bar("", matrix_px - 30),
        },
    )
    return style.ReportFigure(
        "correlation",
        "Correlation of the inverters, hour by hour",
        "Pearson correlation of the true maximum power of every two inverters in each local hour "
        "(no unit). Red: one falls while the other rises. Dark blue: both move together, as on the "
        "diagonal. White lines separate the clusters. These are the correlations in the run "
        "itself, not in the history by which clusters and neighbours were chosen.",
        figure,
    )


def _mark_clusters(
    figure: go.Figure, series: RunSeries, row: int, column: int, matrix_px: int
) -> None:
    """Name the clusters beside a matrix of the first column, and draw lines between them."""
    sizes = [len(members) for members in clusters(series).values()]
    ends = list(accumulate(sizes))
    step = max(1, -(-len(sizes) * _NAME_PX // matrix_px))
    for end in ends[:-1]:
        line = {"color": "white", "width": 1.5}
        figure.add_vline(x=end - 0.5, line=line, row=row, col=column)
        figure.add_hline(y=end - 0.5, line=line, row=row, col=column)
    figure.update_yaxes(
        tickvals=[end - (size + 1) / 2.0 for end, size in zip(ends, sizes, strict=True)][::step],
        ticktext=[style.plain(cluster or "plant") for cluster in clusters(series)][::step],
        tickfont_size=11,
        showticklabels=column == 1,
        row=row,
        col=column,
    )
