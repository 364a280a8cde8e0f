"""Figures of virtual neighbours: two of them at work, and how inverters are correlated."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from recordings.read.series import RunSeries
from studies.report.cloud_passage import (
    CloudPassage,
    clusters,
    correlation_by_hour,
    find_cloud_passage,
    inverters_by_cluster,
)
from studies.report.style import (
    BLACK,
    BLUE,
    ORANGE,
    ReportFigure,
    clock_range_ms,
    colour_bar,
    diverging_scale,
    dress,
    label_time_axis,
    plain,
    time_line,
)

_MATRICES_ACROSS = 5
_MATRIX_PX = 178


def virtual_neighbours(series: RunSeries) -> ReportFigure | None:
    """Draw IMPP and returned alpha of two virtual neighbours around a cloud passage.

    Parameters
    ----------
    series
        The run.

    Returns
    -------
    ReportFigure or None
        None where `find_cloud_passage` finds none.
    """
    passage = find_cloud_passage(series)
    if passage is None:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    for inverter, colour in ((passage.shaded, ORANGE), (passage.helping, BLUE)):
        look = {"name": plain(series.inverters[inverter]), "line": {"color": colour, "width": 2}}
        impp = time_line(series, series.impp_kw[:, inverter], passage.cycles, **look)
        alpha = time_line(
            series, series.alpha[:, inverter], passage.cycles, showlegend=False, **look
        )
        alpha.hovertemplate = "%{y:.3f}"
        figure.add_trace(impp, row=1, col=1)
        figure.add_trace(alpha, row=2, col=1)
    for request in _request_lines(series, passage):
        figure.add_trace(request, row=1, col=1)
    dress(figure, 520)
    figure.update_yaxes(title_text="IMPP [kW]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="alpha, power / IMPP", range=[0.0, 1.05], row=2, col=1)
    label_time_axis(figure, series, rows=2)
    figure.update_xaxes(range=clock_range_ms(series, passage.cycles))
    return ReportFigure(
        "neighbours",
        "Two virtual neighbours under a cloud",
        _passage_caption(series, passage),
        figure,
    )


def _request_lines(series: RunSeries, passage: CloudPassage) -> list[go.Scatter]:
    """Return the request made of the two, as one line where it is the same of both."""
    request_kw = series.impp_kw - series.residual_kw
    pair = [passage.shaded, passage.helping]
    same = series.rating_kw[pair[0]] == series.rating_kw[pair[1]]
    lines = []
    for inverter, dash in zip(pair[:1] if same else pair, ("dash", "dot"), strict=False):
        name = "request" if same else plain(f"request of {series.inverters[inverter]}")
        look = {"name": name, "line": {"color": BLACK, "width": 1.2, "dash": dash}}
        lines.append(time_line(series, request_kw[:, inverter], passage.cycles, **look))
    return lines


def _passage_caption(series: RunSeries, passage: CloudPassage) -> str:
    shaded, helping = series.inverters[passage.shaded], series.inverters[passage.helping]
    return (
        f"Above, the estimated maximum power IMPP of two inverters [kW], and the request made of "
        f"them; below, the curtailment level alpha that each was given (no unit). The IMPP of "
        f"{shaded} falls by {passage.drop_kw:,.0f} kW within a minute, up to "
        f"{series.times[passage.bottom]:%H:%M:%S}, while {helping} has power to spare. Chosen by "
        f"rule: of the least correlated pairs of each cluster and hour (here "
        f"{passage.correlation:+.2f}) the one with the largest such drop."
    )


def correlation_matrices(series: RunSeries) -> ReportFigure | None:
    """Draw the correlation matrix of the inverters' maximum power in each local hour.

    Parameters
    ----------
    series
        The run.

    Returns
    -------
    ReportFigure or None
        None where no inverter's power varied in any hour.
    """
    matrices = correlation_by_hour(series)
    if not matrices.hours:
        return None
    order = inverters_by_cluster(series)
    names = [plain(series.inverters[position]) for position in order]
    rows = -(-len(matrices.hours) // _MATRICES_ACROSS)
    height_px = rows * _MATRIX_PX
    figure = make_subplots(
        rows=rows,
        cols=_MATRICES_ACROSS,
        horizontal_spacing=0.02,
        vertical_spacing=30.0 / height_px,
        subplot_titles=[f"{hour} to {hour + 1} h" for hour in matrices.hours],
    )
    for place, matrix in enumerate(matrices.values):
        row, column = place // _MATRICES_ACROSS + 1, place % _MATRICES_ACROSS + 1
        figure.add_trace(
            go.Heatmap(
                z=matrix[np.ix_(order, order)].astype(np.float32),
                x=names,
                y=names,
                coloraxis="coloraxis",
                hovertemplate="%{x}, %{y}: %{z:.2f}<extra></extra>",
            ),
            row=row,
            col=column,
        )
        _mark_clusters(figure, series, row, column)
    dress(figure, height_px + 60, legend=False)
    _square_up(figure)
    figure.update_layout(
        hovermode="closest",
        margin={"b": 20, "t": 40},
        coloraxis={
            "colorscale": diverging_scale(-1.0, 1.0),
            "cmin": -1.0,
            "cmax": 1.0,
            "colorbar": colour_bar("", _MATRIX_PX - 30),
        },
    )
    return ReportFigure(
        "correlation",
        "Correlation of the inverters, hour by hour",
        "Pearson correlation of the true maximum power of each two inverters in the cycles of each "
        "local hour (no unit): red where one falls when the other rises, dark blue where both move "
        "as one, as on the diagonal. Lines part the clusters. This is what the run came to, not "
        "the history by which its neighbours were chosen.",
        figure,
    )


def _mark_clusters(figure: go.Figure, series: RunSeries, row: int, column: int) -> None:
    """Name the clusters beside a matrix of the first column, and draw lines between them."""
    sizes = [len(members) for members in clusters(series).values()]
    ends = list(accumulate(sizes))
    for end in ends[:-1]:
        line = {"color": "white", "width": 1.5}
        figure.add_vline(x=end - 0.5, line=line, row=row, col=column)
        figure.add_hline(y=end - 0.5, line=line, row=row, col=column)
    figure.update_yaxes(
        tickvals=[end - (size + 1) / 2.0 for end, size in zip(ends, sizes, strict=True)],
        ticktext=[plain(cluster or "plant") for cluster in clusters(series)],
        showticklabels=column == 1,
        row=row,
        col=column,
    )


def _square_up(figure: go.Figure) -> None:
    """Make all matrices squares, without ticks."""
    figure.update_xaxes(showticklabels=False, ticks="", showgrid=False, constrain="domain")
    figure.update_yaxes(ticks="", showgrid=False, autorange="reversed")
    # At the top of their place, below their titles.
    figure.update_yaxes(constrain="domain", constraintoward="top")
    for axis in figure.select_yaxes():
        axis.scaleanchor = axis.plotly_name.replace("axis", "").replace("y", "x", 1)
