"""Figures of the inverters, or of the clusters of a large plant: residuals and correlations."""

from __future__ import annotations

from itertools import accumulate
from typing import Final

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.colors import diverging
from plotly.subplots import make_subplots

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
    noun = series.plant.noun
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
    edges = [end - 0.5 for end in accumulate(map(len, members))][:-1]
    shapes = []
    for panel, matrix in enumerate(matrices.values()):
        row, column = panel // across + 1, panel % across + 1
        figure.add_heatmap(
            z=matrix[np.ix_(order, order)].astype(np.float32),
            x=names,
            y=names,
            coloraxis="coloraxis",
            hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>",
            row=row,
            col=column,
        )
        axis = str(panel + 1) if panel else ""
        look = {"type": "line", "line": {"color": "white", "width": 1.5}}
        across_all = {"x": f"x{axis} domain", "y": f"y{axis} domain"}
        for edge in edges:
            for along, other in ("xy", "yx"):
                ends = {f"{along}0": edge, f"{along}1": edge, f"{other}0": 0, f"{other}1": 1}
                refs = {f"{along}ref": f"{along}{axis}", f"{other}ref": across_all[other]}
                shapes.append(look | ends | refs)
    style.dress(figure, height_px + 60, legend=False)
    # All matrices are squares without ticks, at the top of their panel, below their titles.
    bare = {"showticklabels": False, "ticks": "", "showgrid": False, "constrain": "domain"}
    figure.update_xaxes(**bare)
    figure.update_yaxes(**bare, autorange="reversed", constraintoward="top")
    for axis in figure.select_yaxes():
        axis.scaleanchor = axis.plotly_name.replace("axis", "").replace("y", "x", 1)
    figure.update_layout(
        shapes=shapes,  # All at once: to add lines one by one takes the square of their number.
        margin={"b": 20, "t": 40},
        coloraxis={"colorscale": diverging.RdBu, "cmin": -1.0, "cmax": 1.0}
        | {"colorbar": style.colour_bar("", _MATRIX_PX - 30)},
    )
    noun = series.plant.noun
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
