"""The figure of a comparison: control-caused shortfall against over-delivery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import pandas as pd
import plotly.graph_objects as go

from results.figures import FIGURES
from results.report.style import BLUE, GREY, VERMILLION, ReportFigure, curve, dress, plain
from studies.compare.study import Row

_LEAST_PERCENT: Final = 1e-3
"""Where the logarithmic axes begin: less is drawn as this."""
_LOOKS: Final = {
    "fraction": ("circle", BLUE, "top right"),
    "limit": ("square", VERMILLION, "bottom right"),
}
"""Symbol, colour and place of the label."""


_BEYOND: Final = "over-delivered"
_MISSED: Final = "control-caused"


def frontier(rows: Sequence[Row]) -> ReportFigure:
    """Draw what schemes miss against what they over-deliver, and the frontier of the two.

    A scheme for which one of the two is undefined is left out.
    """
    table = pd.DataFrame(rows).astype({_BEYOND: float, _MISSED: float})
    table = table.dropna(subset=[_BEYOND, _MISSED])
    table["actuator"] = table["actuator"].fillna("")
    table["x"], table["y"] = (table[name].clip(lower=_LEAST_PERCENT) for name in (_BEYOND, _MISSED))
    table["label"] = table["scheme"].map(plain) + ", " + table["rmse"].map("{:,.0f} kW".format)
    across, up = FIGURES[_BEYOND], FIGURES[_MISSED]
    words = f"{up.title.lower()} %{{y:.3f}} %, {across.title.lower()} %{{x:.3f}} %"
    figure = go.Figure()
    for actuator, (symbol, colour, place) in _LOOKS.items():
        own = table[table["actuator"] == actuator]
        figure.add_scatter(
            x=own["x"],
            y=own["y"],
            text=own["label"],
            mode="markers+text",
            name=actuator,
            textposition=place,
            cliponaxis=False,
            marker={"size": 10, "symbol": symbol, "color": colour},
            hovertemplate=f"%{{text}}: {words}",
        )
    drawn = table[table["actuator"] != ""].sort_values(["x", "y"])
    line = {"color": GREY, "width": 1.2, "dash": "dash", "shape": "hv"}
    figure.add_trace(curve(drawn["x"].tolist(), drawn["y"].cummin().tolist(), "frontier", line))
    dress(figure, 480)
    figure.update_layout(hovermode="closest", margin_r=180)
    figure.update_xaxes(title_text=across.heading, type="log", dtick=1)
    figure.update_yaxes(title_text=up.heading, type="log", dtick=1)
    return ReportFigure(
        "frontier",
        f"{up.title} against {across.title.lower()}",
        "Each scheme with its tracking RMSE; both axes logarithmic. No scheme is better in both "
        f"than one on the dashed frontier. Less than {_LEAST_PERCENT:g} % is drawn as that.",
        figure,
    )
