"""The result of a timed run, with its figures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
import plotly.graph_objects as go

from bus_schemas.errors import listed
from bus_schemas.tree import CENTRAL, PLANT, ControlTree
from results.report import style
from results.report.decimation import extremes
from results.report.result import Result
from results.timing import tables
from results.timing.budgets import Verdict
from results.timing.cycle_waits import CycleWaits, Wait
from results.timing.report import TimingReport
from results.timing.run_timing import LOOP, WHOLE_LOOP, Times, curve_shares

_HOPS: Final = (
    "(each time begins when the agent's last input was published, so it includes the hop)"
)

_CURVES: Final = (
    ("loop", "Loop time and lateness", (LOOP, "lateness", "response")),
    ("decision", "Decision time by tier", ("decision",)),
    ("hop", "Hop latency by signal", ("hop",)),
)

CURVES_PX: Final = 440
_ROW_PX: Final = 17
_FRAME_PX: Final = 120

ROUND_TICKS: Final = {
    "tickvals": [digit * 10.0**power for power in range(-3, 6) for digit in (1, 2, 5)],
    "tickformat": ",~g",
}

_PERCENTILES: Final = (0.0, 50.0, 90.0, 99.0, 99.9, 99.99, 99.999)
"""What the axis of percentiles shows."""


def timing_result(report: TimingReport) -> Result:
    """Return the timing of a run: what was run, how long it took, and whether it was in time."""
    slowest = [
        f"{'next' if place else 'slowest'} {one.in_words()}"
        for place, one in enumerate(report.slowest)
    ]
    return Result(
        f"{report.scenario}: timing of run {report.run_id}",
        tables.measured_tables(report),
        report.document(),
        lines=tables.header_lines(report),
        conclusions=[
            *slowest,
            *([_HOPS] if slowest else []),
            *(f"not kept: {line}" for line in tables.failures(report)),
        ],
        verdict=(report.passed, tables.verdict_line(report)),
        figures=lambda: run_figures(report),
    )


def run_figures(report: TimingReport) -> list[style.ReportFigure]:
    """Draw the slowest cycles of a run, its loop time and percentiles."""
    return [
        *(
            waits_figure(f"waits-{place}", cycle, report.tree)
            for place, cycle in enumerate(report.slowest, start=1)
        ),
        *([loop_figure(report)] if report.cycles else []),
        *(
            percentile_figure(f"percentiles-{name}", heading, rows, report.verdicts)
            for name, heading, measures in _CURVES
            if (rows := [row for row in report.times if row.measure in measures])
        ),
    ]


def waits_figure(anchor: str, cycle: CycleWaits, tree: ControlTree) -> style.ReportFigure:
    """Draw who waited for whom in a cycle: a row for each agent, in the order of the tree."""
    rows = [PLANT, CENTRAL, *sorted(path for path in tree.nodes if path)]
    chain = {(wait.agent, wait.stage) for wait in cycle.chain}
    others = [wait for wait in cycle.waits if (wait.agent, wait.stage) not in chain]
    # The messages of the chain: from their publisher to the agent that waited for them.
    times_ms: list[float | None] = []
    agents: list[str | None] = []
    for earlier, later in pairwise(cycle.chain):
        times_ms += [earlier.ended_ns / 1e6, earlier.ended_ns / 1e6, None]
        agents += [earlier.agent, later.agent, None]
    dotted = {"color": style.VERMILLION, "width": 1, "dash": "dot"}
    messages = style.curve(times_ms, agents, "messages of the chain", dotted, hoverinfo="skip")
    figure = go.Figure(
        [
            _bars(others, "others", style.faint(style.BLUE, 0.35)),
            _bars(cycle.chain, "chain that set the length of the cycle", style.VERMILLION),
            messages,
        ]
    )
    style.dress(figure, _FRAME_PX + _ROW_PX * len(rows))
    figure.update_layout(barmode="overlay", bargap=0.25)
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
    return style.ReportFigure(
        anchor,
        f"Who waited for whom in cycle {cycle.cycle:,}",
        f"A bar begins when the last input that an agent waited for was published and ends with "
        f"the agent's last message of that stage; it includes the hop. Orange: the chain from the "
        f"tick to the plant's production, {cycle.loop_ns / 1e6:.1f} ms; the other bars did not "
        f"delay the cycle. Longest link: {cycle.slowest.in_words()}.",
        figure,
    )


def _bars(waits: Sequence[Wait], name: str, colour: str) -> go.Bar:
    return go.Bar(
        orientation="h",
        y=[wait.agent for wait in waits],
        base=[wait.began_ns / 1e6 for wait in waits],
        x=[wait.length_ns / 1e6 for wait in waits],
        name=name,
        marker={"color": colour, "line": {"color": "white", "width": 0.5}},
        customdata=[
            style.plain(f"{wait.in_words()}, after {wait.cause or 'the tick'}") for wait in waits
        ],
        hovertemplate="%{customdata}<extra></extra>",
    )


def loop_figure(report: TimingReport) -> style.ReportFigure:
    loop_ms = report.loop_ns / 1e6
    drawn = loop_ms.iloc[extremes(loop_ms.to_numpy())]
    seconds = (drawn.index / report.rate_hz).tolist()
    blue, hover = {"color": style.BLUE, "width": 1.2}, "%{x:,.1f} s: %{y:.2f} ms"
    line = style.curve(seconds, drawn.tolist(), "loop time", blue, hovertemplate=hover)
    ends = [seconds[0], seconds[-1]]
    figure = go.Figure([line, *_budgets(report.verdicts, [(LOOP, WHOLE_LOOP)], ends)])
    style.dress(figure, CURVES_PX)
    figure.update_xaxes(title_text="time since cycle 0 [s]")
    figure.update_yaxes(type="log", title_text="loop time [ms]", **ROUND_TICKS)
    caption = "From the plant's scheduled tick to its last command, cycle by cycle. Black: budgets."
    return style.ReportFigure("loop", "Loop time over time", caption, figure)


def percentile_figure(
    anchor: str, heading: str, rows: Sequence[Times], verdicts: Sequence[Verdict]
) -> style.ReportFigure:
    """Draw durations against their percentiles on axes that show the rare long ones."""
    lines = []
    for place, row in enumerate(rows):
        shares, values_us = curve_shares(row.times.count), np.array(row.times.curve_us)
        line = {**style.scheme_line(place), "width": 1.8, "shape": "hv"}
        curve = style.curve(1.0 / shares, values_us / 1e3, f"{row.measure} {row.of}", line)
        curve.customdata = 100.0 * (1.0 - shares)
        curve.hovertemplate = "%{customdata:.4g} %: %{y:.3f} ms"
        lines.append(curve)
    judged = [(row.measure, row.of) for row in rows]
    figure = go.Figure([*lines, *_budgets(verdicts, judged, [1.0, 100.0])])
    style.dress(figure, CURVES_PX)
    figure.update_layout(margin_t=46 + 22 * (len(figure.data) // 4))
    figure.update_xaxes(
        type="log",
        tickvals=[1.0 / (1.0 - percent / 100.0) for percent in _PERCENTILES],
        ticktext=[f"{percent:g}" for percent in _PERCENTILES],
        title_text="percentile [%]",
    )
    figure.update_yaxes(type="log", title_text="duration [ms]", dtick=1, rangemode="normal")
    caption = (
        "Each step to the right leaves a tenth of the durations: at 99 % one in a hundred is "
        "longer. Black: budgets of the 99th percentile; a curve must cross 99 % below its own."
    )
    return style.ReportFigure(anchor, heading, caption, figure)


def _budgets(
    verdicts: Sequence[Verdict], rows: Sequence[tuple[str, str]], ends: list[float]
) -> list[go.Scatter]:
    """Draw a line for each limit of these rows."""
    judged = [one for one in verdicts if (one.measure, one.of) in rows]
    lines = []
    for place, limit_ms in enumerate(sorted({one.limit for one in judged})):
        name, dash = f"budget {limit_ms:g} ms", ("dash", "dot", "solid")[place % 3]
        whose = listed([one.line for one in judged if one.limit == limit_ms], 3)
        look = {"color": style.BLACK, "width": 1.3, "dash": dash}
        hover = f"{name}: {style.plain(whose)}<extra></extra>"
        lines.append(style.curve(ends, [limit_ms, limit_ms], name, look, hovertemplate=hover))
    return lines
