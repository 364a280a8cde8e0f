"""Figures of a plant's timing: percentile curves, who waited for whom, latency against rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import plotly.graph_objects as go

from bus_schemas.tree import CENTRAL, PLANT, ControlTree
from studies.report.style import (
    BLUE,
    GREY,
    SCHEMES,
    VERMILLION,
    ReportFigure,
    dress,
    faint,
    plain,
)
from studies.timing.cycle_waits import CycleWaits, Wait

_CURVES_PX: Final = 440
_ROW_PX: Final = 17
_FRAME_PX: Final = 120

_SHARES: Final = (1.0, 0.5, 0.1, 0.01, 0.001, 0.0001, 0.00001)
_PERCENTILES: Final = ("0", "50", "90", "99", "99.9", "99.99", "99.999")
"""What the axis of percentiles shows: each step to the right leaves a tenth of the durations."""

_DASHES: Final = ("solid", "dash", "dot")
_FLOOR: Final = {"color": GREY, "width": 1.5}
_HOP: Final = "#d8d8d8"


@dataclass(frozen=True, slots=True)
class PercentileCurve:
    """A distribution of durations.

    Attributes
    ----------
    name
        What was measured.
    shares
        Shares of the durations that exceed a value, falling from 1.
    values_ms
        Those values [ms].
    floor
        Whether it is what the machine itself needs.
    """

    name: str
    shares: list[float]
    values_ms: list[float]
    floor: bool = False


@dataclass(frozen=True, slots=True)
class RatePoint:
    """What a plant came to at one rate.

    Attributes
    ----------
    rate_hz
        Cycles a second.
    p50_ms, p99_ms, max_ms
        Loop time [ms].
    clean
        Whether no deadline was missed, none overrun and nothing lost.
    """

    rate_hz: float
    p50_ms: float
    p99_ms: float
    max_ms: float
    clean: bool


def percentile_curves(
    anchor: str, heading: str, caption: str, curves: Sequence[PercentileCurve]
) -> ReportFigure:
    """Draw durations against their percentiles, both so that the rare long ones can be seen.

    Parameters
    ----------
    anchor, heading, caption
        See `ReportFigure`.
    curves
        What to draw; those of the floor are grey.
    """
    figure = go.Figure()
    solid = [curve for curve in curves if not curve.floor]
    for place, curve in enumerate(solid):
        colour = SCHEMES[place % len(SCHEMES)]
        dash = _DASHES[place // len(SCHEMES) % len(_DASHES)]
        figure.add_trace(_curve(curve, {"color": colour, "dash": dash, "width": 1.8}))
    for place, curve in enumerate(curve for curve in curves if curve.floor):
        figure.add_trace(_curve(curve, {**_FLOOR, "dash": _DASHES[place % len(_DASHES)]}))
    least = min((share for curve in curves for share in curve.shares), default=0.01)
    figure = dress(figure, _CURVES_PX)
    figure.update_layout(hovermode="closest", margin_t=46 + 22 * (len(curves) // 5))
    figure.update_xaxes(
        type="log",
        range=[0.0, _decades(least)],
        tickvals=[1.0 / share for share in _SHARES],
        ticktext=list(_PERCENTILES),
        title_text="percentile [%]",
    )
    figure.update_yaxes(type="log", title_text="duration [ms]", dtick=1, rangemode="normal")
    return ReportFigure(anchor, heading, caption, figure)


def waits_figure(anchor: str, cycle: CycleWaits, tree: ControlTree) -> ReportFigure:
    """Draw who waited for whom in a cycle: a row for each agent, time to the right.

    Parameters
    ----------
    anchor
        See `ReportFigure`.
    cycle
        The cycle.
    tree
        Control tree of the run: gives the rows their order.
    """
    rows = [PLANT, CENTRAL, *_in_tree_order(tree)]
    chain = {(wait.agent, wait.stage) for wait in cycle.chain}
    others = [wait for wait in cycle.waits if (wait.agent, wait.stage) not in chain]
    figure = go.Figure()
    figure.add_trace(_bars(others, "beside it", faint(BLUE, 0.35)))
    figure.add_trace(_bars(cycle.chain, "chain that made the cycle so long", VERMILLION))
    figure.add_trace(_links(cycle.chain))
    height_px = _FRAME_PX + _ROW_PX * len(rows)
    figure = dress(figure, height_px)
    figure.update_layout(barmode="overlay", hovermode="closest", bargap=0.25)
    figure.update_yaxes(
        categoryorder="array",
        categoryarray=rows,
        range=[len(rows) - 0.4, -0.6],
        tickfont={"size": 11},
        automargin=True,
        showgrid=False,
        dtick=1,
    )
    figure.update_xaxes(title_text="time after the plant's scheduled tick [ms]", rangemode="tozero")
    caption = (
        f"A bar lasts from the moment at which the last input was published that an agent waited "
        f"for to its own last message of that stage: the hop is in it. Orange: the chain from the "
        f"tick to the plant's production, {cycle.loop_ns / 1e6:.1f} ms; whatever is beside it did "
        f"not delay the cycle. Its longest link: {cycle.slowest.in_words()}."
    )
    heading = f"Who waited for whom in cycle {cycle.cycle:,}"
    return ReportFigure(anchor, heading, caption, figure)


def rate_figure(points: Sequence[RatePoint]) -> ReportFigure:
    """Draw loop times against the rate, beside the length of a cycle."""
    rates_hz = [point.rate_hz for point in points]
    figure = go.Figure()
    for place, name in enumerate(("p50", "p99", "max")):
        values_ms = [getattr(point, f"{name}_ms") for point in points]
        figure.add_trace(
            go.Scatter(
                x=rates_hz,
                y=values_ms,
                name=f"loop {name}",
                mode="lines+markers",
                marker={"symbol": ["circle" if p.clean else "x" for p in points], "size": 9},
                line={"color": SCHEMES[place], "width": 1.8},
                hovertemplate="%{x:g} cycles/s: %{y:.2f} ms",
            )
        )
    figure.add_trace(
        go.Scatter(
            x=rates_hz,
            y=[1e3 / rate_hz for rate_hz in rates_hz],
            name="length of a cycle",
            mode="lines",
            line={**_FLOOR, "dash": "dash"},
            hovertemplate="%{y:.2f} ms",
        )
    )
    figure = dress(figure, _CURVES_PX)
    figure.update_layout(hovermode="closest")
    figure.update_xaxes(
        type="log",
        title_text="rate [cycles/s]",
        tickvals=rates_hz,
        ticktext=[f"{rate_hz:g}" for rate_hz in rates_hz],
    )
    figure.update_yaxes(type="log", title_text="time [ms]", **_round_ticks())
    caption = (
        "Time from the plant's scheduled tick to its last command. A circle is a rate at which no "
        "deadline was missed, no stage overran and nothing was lost; a cross is one that the plant "
        "did not keep up with."
    )
    return ReportFigure("rates", "Loop time against rate", caption, figure)


def _curve(curve: PercentileCurve, line: dict[str, object]) -> go.Scatter:
    return go.Scatter(
        x=[1.0 / share for share in curve.shares],
        y=curve.values_ms,
        name=plain(curve.name),
        mode="lines",
        line={**line, "shape": "hv"},
        customdata=[100.0 * (1.0 - share) for share in curve.shares],
        hovertemplate="%{customdata:.4g} %: %{y:.3f} ms",
    )


def _round_ticks() -> dict[str, object]:
    """Name 1, 2 and 5 of each decade of a logarithmic axis."""
    values = [digit * 10.0**power for power in range(-4, 6) for digit in (1, 2, 5)]
    return {"tickvals": values, "ticktext": [f"{value:,.10g}" for value in values]}


def _decades(least_share: float) -> float:
    """Length of the axis: up to the next whole percentile that is shown."""
    return next((float(place) for place in range(1, 6) if 10.0**-place <= least_share), 5.0)


def _bars(waits: Sequence[Wait], name: str, colour: str) -> go.Bar:
    return go.Bar(
        orientation="h",
        y=[wait.agent for wait in waits],
        base=[wait.began_ns / 1e6 for wait in waits],
        x=[wait.length_ns / 1e6 for wait in waits],
        name=name,
        marker={"color": colour, "line": {"color": "white", "width": 0.5}},
        customdata=[_told(wait) for wait in waits],
        hovertemplate="%{customdata}<extra></extra>",
    )


def _links(chain: Sequence[Wait]) -> go.Scatter:
    """Draw the chain's messages: down from the one who said them to the one who waited."""
    times_ms: list[float | None] = []
    agents: list[str | None] = []
    for earlier, later in pairwise(chain):
        times_ms += [earlier.ended_ns / 1e6, earlier.ended_ns / 1e6, None]
        agents += [earlier.agent, later.agent, None]
    return go.Scatter(
        x=times_ms,
        y=agents,
        name="its messages",
        mode="lines",
        line={"color": VERMILLION, "width": 1, "dash": "dot"},
        hoverinfo="skip",
    )


def _told(wait: Wait) -> str:
    cause = "the clock" if wait.cause is None else str(wait.cause)
    lines = [
        wait.in_words(),
        f"from {cause} at {wait.began_ns / 1e6:.2f} ms",
        f"to {wait.message} at {wait.ended_ns / 1e6:.2f} ms",
    ]
    return "<br>".join(map(plain, lines))


def _in_tree_order(tree: ControlTree) -> list[str]:
    """Return the nodes below the root, each parent before its children."""
    return sorted(path for path in tree.nodes if path)
