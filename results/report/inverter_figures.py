"""Figures of the inverters: their residuals, neighbours under a cloud, and correlations."""

from __future__ import annotations

from itertools import accumulate
from typing import Final

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.colors import diverging
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from results.report import style
from results.report.cloud_passage import (
    clusters,
    correlation_by_hour,
    find_cloud_passage,
    inverters_by_cluster,
)
from results.report.decimation import least_per_bucket

_LEAST_MAP_PX: Final = 160
_MOST_NAMES: Final = 151
_NAME_PX: Final = 15
"""So many inverters have a name each, in a row of this height."""
_ACROSS: Final = 4
_MATRIX_PX: Final = 230


def residuals(series: RunSeries) -> style.ReportFigure:
    """Draw the residual of every inverter as a heat map."""
    count = len(series.inverters)
    every = 1 + count // _MOST_NAMES
    map_px = max(count * max(_NAME_PX // every, 1), _LEAST_MAP_PX)
    order = inverters_by_cluster(series)
    cells_kw, rows = least_per_bucket(series.residual_kw[:, order])
    cell_ms = rows * series.cycle_s * 1e3
    # Without the few largest on either side, which would leave the rest pale.
    least_kw = min(-1.0, float(np.nanquantile(cells_kw, 0.005)))
    greatest_kw = max(1.0, float(np.nanquantile(cells_kw, 0.995)))
    zero = -least_kw / (greatest_kw - least_kw)
    places = np.interp(np.linspace(-1.0, 1.0, len(diverging.RdBu)), (-1, 0, 1), (0.0, zero, 1.0))
    cells = go.Heatmap(
        z=cells_kw.T.astype(np.float32),
        x0=style.clock_ms(series)[0] + cell_ms / 2.0,
        dx=cell_ms,
        y=[style.plain(series.inverters[position]) for position in order],
        colorscale=list(zip(places.tolist(), diverging.RdBu, strict=True)),
        zmin=least_kw,
        zmax=greatest_kw,
        colorbar=style.colour_bar("kW", map_px),
        hovertemplate="%{y}: %{z:,.1f} kW<extra></extra>",
    )
    figure = style.dress(go.Figure(cells), map_px + 80, legend=False)
    figure.update_yaxes(autorange="reversed", showgrid=False, dtick=every, tickfont_size=11)
    style.label_time_axis(figure, series)
    figure.update_layout(hovermode="closest")
    worst_kw = np.fmin.reduce(series.residual_kw, axis=1)
    needy = 100.0 * np.mean(worst_kw[np.isfinite(worst_kw)] < 0.0)
    return style.ReportFigure(
        "residuals",
        "Residuals of the inverters",
        "Residual of each inverter, IMPP less share [kW]. Red: a deficit, for which "
        "it needs help. Blue: it has headroom. The two sides have scales of their own. In a long "
        "run a cell shows the least residual of the cycles that it covers. At least one inverter "
        f"needed help in {needy:.1f} % of the cycles.",
        figure,
    )


def virtual_neighbours(series: RunSeries) -> style.ReportFigure | None:
    """Draw IMPP and returned alpha of two virtual neighbours around a cloud passage, if any."""
    passage = find_cloud_passage(series)
    if passage is None:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    share_kw = series.impp_kw - series.residual_kw
    for inverter, colour in ((passage.shaded, style.ORANGE), (passage.helping, style.BLUE)):
        name, line = series.inverters[inverter], {"color": colour, "width": 2}
        for values, of, look, row in (
            (series.impp_kw, name, {}, 1),
            (share_kw, f"share of {name}", {"line_width": 1.2, "line_dash": "dash"}, 1),
            (series.alpha, name, {"showlegend": False, "hovertemplate": "%{y:.3f}"}, 2),
        ):
            shown = style.time_line(series, values[:, inverter], of, line, passage.cycles)
            figure.add_trace(shown.update(look), row=row, col=1)
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
        "Above: IMPP, the estimated maximum power of two inverters, and their share of the "
        "dispatch [kW]. Below: their curtailment level alpha (no unit). The IMPP of "
        f"{shaded} falls by {passage.drop_kw:,.0f} kW within a minute, until {moment}, "
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
    ends = accumulate(len(members) for members in clusters(series).values())
    edges = [end - 0.5 for end in ends][:-1]
    midnight = series.times[0].tz_localize(None).normalize()
    hours = [midnight + pd.Timedelta(hours=hour) for hour in matrices]
    across = min(_ACROSS, len(matrices))
    rows = -(-len(matrices) // across)
    height_px = rows * _MATRIX_PX
    figure = make_subplots(
        rows=rows,
        cols=across,
        horizontal_spacing=0.02,
        vertical_spacing=30.0 / height_px,
        subplot_titles=[f"{hour.day} {hour:%b}, {hour.hour} h" for hour in hours],
    )
    for place, matrix in enumerate(matrices.values()):
        panel = {"row": place // across + 1, "col": place % across + 1}
        figure.add_heatmap(
            z=matrix[np.ix_(order, order)].astype(np.float32),
            x=names,
            y=names,
            coloraxis="coloraxis",
            hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>",
            **panel,
        )
        for edge in edges:
            line = {"color": "white", "width": 1.5}
            figure.add_vline(x=edge, line=line, **panel)
            figure.add_hline(y=edge, line=line, **panel)
    style.dress(figure, height_px + 60, legend=False)
    # All matrices are squares without ticks, at the top of their place, below their titles.
    look = {"showticklabels": False, "ticks": "", "showgrid": False, "constrain": "domain"}
    figure.update_xaxes(**look)
    figure.update_yaxes(**look, autorange="reversed", constraintoward="top")
    for axis in figure.select_yaxes():
        axis.scaleanchor = axis.plotly_name.replace("axis", "").replace("y", "x", 1)
    figure.update_layout(
        margin={"b": 20, "t": 40},
        coloraxis={"colorscale": diverging.RdBu, "cmin": -1.0, "cmax": 1.0}
        | {"colorbar": style.colour_bar("", _MATRIX_PX - 30)},
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
