"""Figures of the inverters, or of the clusters of a large plant: residuals and correlations."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd
import plotly.express as px
import plotly.graph_objects as go
from plotly.colors import diverging

from agents.control.correlation import hourly_correlation
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
    order = _by_parent(series)
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
    """Draw the correlation of the inverters' maximum power in each local hour (eq. 5).

    Hours in which no inverter's power varies, such as those of the night, are left out; None where
    there are no others.
    """
    local, order = series.times.tz_localize(None), _by_parent(series)
    mpp_kw = series.mpp_kw[:, order]
    known = np.isfinite(mpp_kw).all(axis=1)
    hours = np.asarray((local - pd.Timestamp(0)) // pd.Timedelta(hours=1))[known]
    found = hourly_correlation(mpp_kw[known], hours)
    matrices = {hour: matrix for hour, matrix in found.items() if np.any(matrix < 1.0)}
    if not matrices:
        return None
    names = [style.plain(series.inverters[position]) for position in order]
    figure = px.imshow(
        np.array([*matrices.values()], dtype=np.float32),
        x=names,
        y=names,
        facet_col=0,
        facet_col_wrap=min(_ACROSS, len(matrices)),
        facet_col_spacing=0.02,
        zmin=-1.0,
        zmax=1.0,
        color_continuous_scale=diverging.RdBu,
    )
    begins = [pd.Timestamp(hour, unit="h") for hour in matrices]
    for title in figure.layout.annotations:
        begin = begins[int(title.text.split("=")[1])]
        title.text = f"{begin.day} {begin:%b}, {begin.hour} h"
    figure.update_traces(hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>")
    style.dress(figure, -(-len(matrices) // _ACROSS) * _MATRIX_PX + 60, legend=False)
    figure.update_xaxes(showticklabels=False, ticks="", showgrid=False)
    figure.update_yaxes(showticklabels=False, ticks="", showgrid=False, constraintoward="top")
    figure.update_layout(coloraxis={"colorbar": style.colour_bar("", _MATRIX_PX - 30)})
    noun = series.noun
    return style.ReportFigure(
        "correlation",
        f"Correlation of the {noun}s, hour by hour",
        f"Pearson correlation of the true maximum power of every two {noun}s, by cluster, in each "
        "local hour. Red: one falls while the other rises. Dark blue: both move together, as on "
        "the diagonal. These are the correlations in the run itself, not in the history by which "
        "clusters and neighbours were chosen.",
        figure,
    )


def _by_parent(series: RunSeries) -> list[int]:
    """Return the positions of the inverters, those with the same parent together."""
    members: dict[str, list[int]] = {}
    for position, path in enumerate(series.inverters):
        members.setdefault(parent_of(path), []).append(position)
    return [position for together in members.values() for position in together]
