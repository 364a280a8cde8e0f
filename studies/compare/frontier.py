"""The figure of a comparison: control-caused shortfall against over-delivery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, cast

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


class Turned(NamedTuple):
    """What `--frontier` turns: a field and its values, and the figures that it trades."""

    field: str
    values: tuple[float, ...]
    x: str
    y: str
    title: str


MISSED, BEYOND, _ = AXES

TURNED: Final = {
    "offset": Turned(
        "control.offset",
        (-0.01, -0.005, -0.002, 0.0, 0.001, 0.002, 0.005, 0.01, 0.02),
        BEYOND,
        MISSED,
        "What an offset of the plant's target buys",
    ),
    "offset_errors": Turned(
        "control.offset_errors",
        (-1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0),
        BEYOND,
        MISSED,
        "What an offset of the plant's target buys",
    ),
    "promise": Turned(
        "commitment.reliability",
        (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99),
        "curtailed",
        "shortfall",
        "What a promise costs",
    ),
}
"""What can be turned, by its name on the command line."""


def turned(knob: Turned, results: Sequence[Sequence[Row]]) -> list[Row]:
    """Return a row for each scheme, actuator and value of a knob: means over the cases."""
    rows = pd.DataFrame(row for rows in results for row in rows)
    keys = ["scheme", "actuator", knob.field]
    figures = list(dict.fromkeys((*AXES, knob.x, knob.y)))
    means = rows.groupby(keys, sort=False, dropna=False)[figures].mean().reset_index()
    means["actuator"] = means["actuator"].astype(object).where(means["actuator"].notna(), None)
    return cast(list[Row], means.to_dict("records"))


def frontier_table(knob: Turned, rows: Sequence[Row]) -> Table:
    """Return the figures of each scheme with each value of the knob."""
    names, figures = ("scheme", "actuator"), dict.fromkeys((knob.y, knob.x, *AXES))
    knob_column = Column(knob.field.rpartition(".")[2])
    columns = (*map(key_column, names), knob_column, *(FIGURES[name].column for name in figures))
    fields = (*names, knob.field, *figures)
    cells = [
        tuple(f"{row[name]:g}" if name == knob.field else row[name] for name in fields)
        for row in sorted(rows, key=lambda row: (row["scheme"], row["actuator"] or ""))
    ]
    return Table(knob.title, columns, cells)


def _labels(rows: Sequence[Row], knob: str) -> list[str]:
    """Return the label of each point: of a curve, that of its first one alone."""
    if not any(knob in row for row in rows):
        return [f"{plain(row['scheme'])}, {row[AXES[2]]:,.0f} kW" for row in rows]
    schemes = [row["scheme"] for row in rows]
    return ["" if name in schemes[:at] else plain(name) for at, name in enumerate(schemes)]


def _words(figure: str) -> str:
    return FIGURES[figure].title.lower()


def frontier(rows: Sequence[Row], knob: Turned = TURNED["offset"]) -> ReportFigure:
    """Draw the two figures that a knob trades, and the frontier of the two.

    A scheme with several values of the knob is a curve.
    """
    missing, beyond, rmse, offset = knob.y, knob.x, AXES[2], knob.field
    figure = go.Figure()
    for actuator, (symbol, colour, place) in _LOOKS.items():
        entries = [row for row in rows if row["actuator"] == actuator]
        figure.add_scatter(
            x=[max(row[beyond] or 0.0, _LEAST_PERCENT) for row in entries],
            y=[max(row[missing] or 0.0, _LEAST_PERCENT) for row in entries],
            text=_labels(entries, offset),
            hovertext=[
                f"{plain(row['scheme'])}, "
                + (f"{row[offset]:g}" if offset in row else f"{row[rmse]:,.0f} kW")
                for row in entries
            ],
            mode="markers+text",
            name=actuator,
            textposition=place,
            cliponaxis=False,
            marker={"size": 10, "symbol": symbol, "color": colour},
            hovertemplate=(
                f"%{{hovertext}}: {_words(missing)} %{{y:.3f}} %, {_words(beyond)} %{{x:.3f}} %"
            ),
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
        f"{FIGURES[missing].title} against {_words(beyond)}",
        f"Each scheme with its tracking RMSE, or as a curve over {offset}; both axes logarithmic. "
        "No scheme is better in both than one on the dashed frontier. Less than "
        f"{_LEAST_PERCENT:g} % is drawn as that.",
        figure,
    )
