"""The figure of a comparison: control-caused shortfall against over-delivery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, cast

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from results.figures import FIGURES
from results.report.style import BLUE, GREY, VERMILLION, ReportFigure, curve, dress, plain
from results.tables import Column, Table, key_column
from studies.compare.results import AXES
from studies.compare.study import Row

_LEAST_PERCENT: Final = 1e-3
"""Where the logarithmic axes begin: less is drawn as this."""
_LOOKS: Final = {
    "fraction": ("circle", BLUE, "top right"),
    "limit": ("square", VERMILLION, "bottom right"),
}
"""Symbol, colour and place of the label."""


OFFSETS: Final[dict[str, tuple[float, ...]]] = {
    "offset": (-0.01, -0.005, -0.002, 0.0, 0.001, 0.002, 0.005, 0.01, 0.02),
    "offset_errors": (-1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0),
}
"""What `--frontier` turns, fields of `control`, and the values that each takes."""


def turned(field: str, results: Sequence[Sequence[Row]]) -> list[Row]:
    """Return a row for each scheme, actuator and value of an offset: means over the cases."""
    rows = pd.DataFrame(row for rows in results for row in rows)
    keys = ["scheme", "actuator", f"control.{field}"]
    means = rows.groupby(keys, sort=False, dropna=False)[list(AXES)].mean().reset_index()
    means["actuator"] = means["actuator"].astype(object).where(means["actuator"].notna(), None)
    return cast(list[Row], means.to_dict("records"))


def frontier_table(field: str, rows: Sequence[Row]) -> Table:
    """Return what each scheme misses and over-delivers with each value of the offset."""
    names = ("scheme", "actuator")
    columns = (*map(key_column, names), Column(field), *(FIGURES[name].column for name in AXES))
    fields = (*names, f"control.{field}", *AXES)
    cells = [
        tuple(f"{row[name]:g}" if name == f"control.{field}" else row[name] for name in fields)
        for row in sorted(rows, key=lambda row: (row["scheme"], row["actuator"] or ""))
    ]
    return Table("What an offset of the plant's target buys", columns, cells)


def frontier(rows: Sequence[Row], field: str = "offset") -> ReportFigure:
    """Draw control-caused shortfall against over-delivery, and the frontier of the two.

    A scheme with several offsets is a curve.
    """
    missing, beyond, rmse = AXES
    offset = f"control.{field}"
    figure = go.Figure()
    for actuator, (symbol, colour, place) in _LOOKS.items():
        entries = [row for row in rows if row["actuator"] == actuator]
        figure.add_scatter(
            x=[max(row[beyond] or 0.0, _LEAST_PERCENT) for row in entries],
            y=[max(row[missing] or 0.0, _LEAST_PERCENT) for row in entries],
            text=[
                f"{plain(row['scheme'])}, "
                + (f"{row[offset]:g}" if offset in row else f"{row[rmse]:,.0f} kW")
                for row in entries
            ],
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
    for scheme, actuator in dict.fromkeys((row["scheme"], row["actuator"]) for row in rows):
        own = [row for row in rows if (row["scheme"], row["actuator"]) == (scheme, actuator)]
        if len(own) > 1:
            x, y = ([max(row[axis], _LEAST_PERCENT) for row in own] for axis in (beyond, missing))
            look = {"color": _LOOKS[actuator][1] if actuator else GREY, "width": 1.0}
            figure.add_trace(curve(x, y, f"{scheme}, {actuator}", look))
    dress(figure, 480)
    figure.update_layout(hovermode="closest", margin_r=180)
    figure.update_xaxes(title_text=FIGURES[beyond].heading, type="log", dtick=1)
    figure.update_yaxes(title_text=FIGURES[missing].heading, type="log", dtick=1)
    return ReportFigure(
        "frontier",
        "Control-caused shortfall against over-delivery",
        "Each scheme with its tracking RMSE, or with the offset where that is turned; both axes "
        "logarithmic. No scheme is better in both than one on the dashed frontier. Less than "
        f"{_LEAST_PERCENT:g} % is drawn as that.",
        figure,
    )
