"""The figure of a comparison: control-caused shortfall against over-delivery."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, cast

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

_OFFSETS: Final = {
    "offset": (-0.01, -0.005, -0.002, 0.0, 0.001, 0.002, 0.005, 0.01, 0.02),
    "offset_errors": (-1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0),
}

TURNED: Final = {
    name: Turned(
        f"control.{name}", values, BEYOND, MISSED, "Shortfall and over-delivery, by offset"
    )
    for name, values in _OFFSETS.items()
} | {
    "promise": Turned(
        "commitment.reliability",
        (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99),
        "curtailed",
        "shortfall",
        "Shortfall and curtailed energy, by reliability",
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


def frontier(rows: Sequence[Row], knob: Turned = TURNED["offset"]) -> ReportFigure:
    """Draw the two figures that a knob trades, and the frontier of the two.

    A scheme with several values of the knob is a curve, and has its label once.
    """
    table = pd.DataFrame(rows)
    table["actuator"] = table["actuator"].fillna("")
    errors = table[[knob.x, knob.y]].astype(float).fillna(0.0)
    table[["x", "y"]] = errors.clip(lower=_LEAST_PERCENT).to_numpy()
    names = table["scheme"].map(plain)
    is_turned = knob.field in table
    by, style = (knob.field, "{:g}") if is_turned else ("rmse", "{:,.0f} kW")
    shown = table[by].map(style.format)
    table["hover"] = names + ", " + shown
    again = table.duplicated(["actuator", "scheme"])
    table["label"] = names.mask(again, "") if is_turned else table["hover"]
    across, up = FIGURES[knob.x], FIGURES[knob.y]
    words = f"{up.title.lower()} %{{y:.3f}} %, {across.title.lower()} %{{x:.3f}} %"
    figure = go.Figure()
    for actuator, (symbol, colour, place) in _LOOKS.items():
        own = table[table["actuator"] == actuator]
        figure.add_scatter(
            x=own["x"],
            y=own["y"],
            text=own["label"],
            hovertext=own["hover"],
            mode="markers+text",
            name=actuator,
            textposition=place,
            cliponaxis=False,
            marker={"size": 10, "symbol": symbol, "color": colour},
            hovertemplate=f"%{{hovertext}}: {words}",
        )
    drawn = table[table["actuator"] != ""].sort_values(["x", "y"])
    line = {"color": GREY, "width": 1.2, "dash": "dash", "shape": "hv"}
    figure.add_trace(curve(drawn["x"].tolist(), drawn["y"].cummin().tolist(), "frontier", line))
    for key, own in table.groupby(["scheme", "actuator"], sort=False):
        if len(own) > 1:
            scheme, actuator = cast(tuple[str, str], key)
            look = {"color": _LOOKS[actuator][1] if actuator else GREY, "width": 1.0}
            name = f"{scheme}, {actuator or None}"
            figure.add_trace(curve(own["x"].tolist(), own["y"].tolist(), name, look))
    dress(figure, 480)
    figure.update_layout(hovermode="closest", margin_r=180)
    figure.update_xaxes(title_text=across.heading, type="log", dtick=1)
    figure.update_yaxes(title_text=up.heading, type="log", dtick=1)
    return ReportFigure(
        "frontier",
        f"{up.title} against {across.title.lower()}",
        f"Each scheme with its tracking RMSE, or as a curve over {knob.field}; both axes "
        "logarithmic. No scheme is better in both than one on the dashed frontier. Less than "
        f"{_LEAST_PERCENT:g} % is drawn as that.",
        figure,
    )
