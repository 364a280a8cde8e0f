"""Figures of the inverters, or of the clusters of a large plant: residuals and correlations."""

from __future__ import annotations

from itertools import accumulate
from typing import Final

import numpy as np
import pandas as pd
import plotly.express as px
import plotly.graph_objects as go
from plotly.colors import diverging

from agents.control.correlation import HourlyMatrices, hourly_correlation
from bus_schemas.tree import parent_of
from recordings.read.series import RunSeries
from results.report import style
from results.report.decimation import least_per_bucket

MOST_INVERTERS: Final = 150
"""So many have a row each; in a larger plant clusters stand for their inverters."""

_LEAST_MAP_PX: Final = 160
_NAME_PX: Final = 15
_ACROSS: Final = 4
_MATRIX_PX: Final = 230


def residuals(series: RunSeries) -> style.ReportFigure:
    """Draw the residual of every inverter as a heat map."""
    map_px = max(len(series.inverters) * _NAME_PX, _LEAST_MAP_PX)
    order = [position for members in families(series).values() for position in members]
    cells_kw, rows = least_per_bucket(series.residual_kw[:, order])
    cell_ms = rows * series.cycle_s * 1e3
    # Without the few largest on either side, which would leave the rest pale.
    least_kw = min(-1.0, float(np.nanquantile(cells_kw, 0.005)))
    greatest_kw = max(1.0, float(np.nanquantile(cells_kw, 0.995)))
    zero = -least_kw / (greatest_kw - least_kw)
    stops = np.interp(np.linspace(-1.0, 1.0, len(diverging.RdBu)), (-1, 0, 1), (0.0, zero, 1.0))
    cells = go.Heatmap(
        z=cells_kw.T.astype(np.float32),
        x0=style.clock_ms(series)[0] + cell_ms / 2.0,
        dx=cell_ms,
        y=[style.plain(series.inverters[position]) for position in order],
        colorscale=list(zip(stops.tolist(), diverging.RdBu, strict=True)),
        zmin=least_kw,
        zmax=greatest_kw,
        colorbar=style.colour_bar("kW", map_px),
        hovertemplate="%{y}: %{z:,.1f} kW<extra></extra>",
    )
    figure = style.dress(go.Figure(cells), map_px + 80, legend=False)
    figure.update_yaxes(autorange="reversed", showgrid=False, dtick=1, tickfont_size=11)
    style.label_time_axis(figure, series)
    figure.update_layout(hovermode="closest")
    worst_kw = np.fmin.reduce(series.residual_kw, axis=1)
    needy = 100.0 * np.mean(worst_kw[np.isfinite(worst_kw)] < 0.0)
    noun = series.noun
    return style.ReportFigure(
        "residuals",
        f"Residuals of the {noun}s",
        f"Residual of each {noun}, IMPP less share [kW]. Red: a deficit, for which "
        "it needs help. Blue: it has headroom. The two sides have scales of their own. In a long "
        f"run a cell shows the least residual of the cycles that it covers. At least one {noun} "
        f"needed help in {needy:.1f} % of the cycles.",
        figure,
    )


def correlation_matrices(series: RunSeries) -> style.ReportFigure | None:
    """Draw the correlation matrix of the inverters' maximum power in each local hour.

    None where no inverter's power varied in any hour.
    """
    matrices = correlation_by_hour(series)
    if not matrices:
        return None
    members = families(series).values()
    order = [position for together in members for position in together]
    names = [style.plain(series.inverters[position]) for position in order]
    midnight = series.times[0].tz_localize(None).normalize()
    begins = (midnight + pd.Timedelta(hours=hour) for hour in matrices)
    hours = {str(n): f"{hour.day} {hour:%b}, {hour.hour} h" for n, hour in enumerate(begins)}
    across = min(_ACROSS, len(matrices))
    height_px = -(-len(matrices) // across) * _MATRIX_PX
    figure = px.imshow(
        np.array([matrix[np.ix_(order, order)] for matrix in matrices.values()], dtype=np.float32),
        x=names,
        y=names,
        facet_col=0,
        facet_col_wrap=across,
        facet_col_spacing=0.02,
        facet_row_spacing=30.0 / height_px,
        zmin=-1.0,
        zmax=1.0,
        color_continuous_scale=diverging.RdBu,
    )
    figure.update_traces(hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>")
    figure.for_each_annotation(lambda title: title.update(text=hours[title.text.split("=")[1]]))
    edges = [end - 0.5 for end in accumulate(map(len, members))][:-1]
    look = {"type": "line", "line": {"color": "white", "width": 1.5}}
    shapes = []
    for panel in figure.data:
        x, y = panel.xaxis, panel.yaxis
        for edge in edges:
            down = {"x0": edge, "x1": edge, "xref": x, "y0": 0, "y1": 1, "yref": f"{y} domain"}
            along = {"y0": edge, "y1": edge, "yref": y, "x0": 0, "x1": 1, "xref": f"{x} domain"}
            shapes += [look | down, look | along]
    style.dress(figure, height_px + 60, legend=False)
    figure.update_xaxes(showticklabels=False, ticks="", showgrid=False)
    figure.update_yaxes(showticklabels=False, ticks="", showgrid=False, constraintoward="top")
    figure.update_layout(
        shapes=shapes,  # All at once: to add lines one by one takes the square of their number.
        margin={"b": 20, "t": 40},
        coloraxis={"colorbar": style.colour_bar("", _MATRIX_PX - 30)},
    )
    noun = series.noun
    return style.ReportFigure(
        "correlation",
        f"Correlation of the {noun}s, hour by hour",
        f"Pearson correlation of the true maximum power of every two {noun}s in each local hour "
        "(no unit). Red: one falls while the other rises. Dark blue: both move together, as on the "
        "diagonal. White lines separate those with different parents. These are the correlations "
        "in the run itself, not in the history by which clusters and neighbours were chosen.",
        figure,
    )


def correlation_by_hour(series: RunSeries) -> HourlyMatrices:
    """Correlate the inverters' true maximum power within each local hour of the run (eq. 5).

    Hours count from the first day's midnight: 34 is 10 to 11 h of the second day. Hours in which
    no inverter's power varies, such as those of the night, are left out.
    """
    local = series.times.tz_localize(None)
    hours = np.asarray((local - local[0].normalize()) // pd.Timedelta(hours=1))
    known = np.isfinite(series.mpp_kw).all(axis=1)
    matrices = hourly_correlation(series.mpp_kw[known], hours[known])
    return {hour: matrix for hour, matrix in matrices.items() if np.any(matrix < 1.0)}


def families(series: RunSeries) -> dict[str, list[int]]:
    """Return the positions of the inverters with the same parent, in the plant's order."""
    members: dict[str, list[int]] = {}
    for position, path in enumerate(series.inverters):
        members.setdefault(parent_of(path), []).append(position)
    return members
