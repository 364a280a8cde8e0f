"""The figure of a comparison: control-caused shortfall against over-delivery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import plotly.graph_objects as go

from results.figures import FIGURES
from results.report.style import BLUE, GREY, VERMILLION, ReportFigure, curve, dress, plain
from studies.compare.results import AXES
from studies.compare.study import Row

_LEAST_PERCENT: Final = 1e-3
"""Where the logarithmic axes begin: less is drawn as this."""
_LOOKS: Final = {
    "fraction": ("circle", BLUE, "top right"),
    "limit": ("square", VERMILLION, "bottom right"),
}
"""Symbol, colour and place of the label."""


def frontier(rows: Sequence[Row]) -> ReportFigure:
    """Draw control-caused shortfall against over-delivery, and the frontier of the two."""
    missing, beyond, rmse = AXES
    figure = go.Figure()
    for actuator, (symbol, colour, place) in _LOOKS.items():
        entries = [row for row in rows if row["actuator"] == actuator]
        figure.add_scatter(
            x=[max(row[beyond] or 0.0, _LEAST_PERCENT) for row in entries],
            y=[max(row[missing] or 0.0, _LEAST_PERCENT) for row in entries],
            text=[f"{plain(row['scheme'])}, {row[rmse]:,.0f} kW" for row in entries],
            mode="markers+text",
            name=actuator,
            textposition=place,
            cliponaxis=False,
            marker={"size": 10, "symbol": symbol, "color": colour},
            hovertemplate="%{text}: %{y:.3f} % control-caused, %{x:.3f} % over-delivered",
        )
    points = sorted(point for trace in figure.data for point in zip(trace.x, trace.y, strict=True))
    least = np.minimum.accumulate([y for _, y in points])
    line = {"color": GREY, "width": 1.2, "dash": "dash", "shape": "hv"}
    figure.add_trace(curve([x for x, _ in points], least, "frontier", line))
    dress(figure, 480)
    figure.update_layout(hovermode="closest", margin_r=180)
    figure.update_xaxes(title_text=FIGURES[beyond].heading, type="log", dtick=1)
    figure.update_yaxes(title_text=FIGURES[missing].heading, type="log", dtick=1)
    return ReportFigure(
        "frontier",
        "Control-caused shortfall against over-delivery",
        "Each scheme with its tracking RMSE, both axes logarithmic. No scheme is better in both "
        f"than one on the dashed frontier. Less than {_LEAST_PERCENT:g} % is drawn as that.",
        figure,
    )
