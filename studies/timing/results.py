"""The result of a timed run, or of several rates, with its figures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import plotly.graph_objects as go

from bus_schemas.tree import CENTRAL, PLANT, ControlTree, some_of
from studies.report import style
from studies.report.decimation import extremes
from studies.report.result import Result
from studies.timing import tables
from studies.timing.budgets import Verdict
from studies.timing.cycle_waits import CycleWaits, Wait
from studies.timing.durations import Times, curve_ms
from studies.timing.report import TimingReport
from studies.timing.run_timing import LOOP, WHOLE_LOOP
from studies.timing.sweep import (
    RateRow,
    Sweep,
    conclusion,
    machine_lines,
    sweep_table,
    trouble_lines,
)

_HOPS: Final = (
    "(each time begins when the agent's last input was published, so it includes the hop)"
)

_CURVES: Final = (
    ("loop", "Loop time and lateness", (LOOP, "lateness", "response")),
    ("decision", "Decision time by tier", ("decision",)),
    ("hop", "Hop latency by signal", ("hop",)),
)

_CURVES_PX: Final = 440
_ROW_PX: Final = 17
_FRAME_PX: Final = 120

_ROUND_TICKS: Final = {
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


def sweep_result(found: Sweep, scenario: str) -> Result:
    """Return the rates, the machine, and the highest clean rate."""
    ran = [row for row in found.rows if row.outcome in {"clean", "not clean"}]
    drawn = [row for row in ran if row.loop_p50_us is not None]
    return Result(
        f"{scenario}: loop time against rate",
        [sweep_table(found)],
        found,
        lines=machine_lines(found),
        conclusions=trouble_lines(found),
        verdict=(found.highest_clean_hz is not None, conclusion(found)),
        figures=lambda: [rate_figure(drawn)] if drawn else [],
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
    style.dress(figure, _CURVES_PX)
    figure.update_xaxes(title_text="time since cycle 0 [s]")
    figure.update_yaxes(type="log", title_text="loop time [ms]", **_ROUND_TICKS)
    caption = "From the plant's scheduled tick to its last command, cycle by cycle. Black: budgets."
    return style.ReportFigure("loop", "Loop time over time", caption, figure)


def percentile_figure(
    anchor: str, heading: str, rows: Sequence[Times], verdicts: Sequence[Verdict]
) -> style.ReportFigure:
    """Draw durations against their percentiles on axes that show the rare long ones."""
    lines = []
    for place, row in enumerate(rows):
        shares, values_ms = curve_ms(row.times)
        line = {**style.scheme_line(place), "width": 1.8, "shape": "hv"}
        rarities = [1.0 / share for share in shares]
        curve = style.curve(rarities, values_ms, f"{row.measure} {row.of}", line)
        curve.customdata = [100.0 * (1.0 - share) for share in shares]
        curve.hovertemplate = "%{customdata:.4g} %: %{y:.3f} ms"
        lines.append(curve)
    judged = [(row.measure, row.of) for row in rows]
    figure = go.Figure([*lines, *_budgets(verdicts, judged, [1.0, 100.0])])
    style.dress(figure, _CURVES_PX)
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
        whose = some_of([one.line for one in judged if one.limit == limit_ms], 3)
        look = {"color": style.BLACK, "width": 1.3, "dash": dash}
        hover = f"{name}: {style.plain(whose)}<extra></extra>"
        lines.append(style.curve(ends, [limit_ms, limit_ms], name, look, hovertemplate=hover))
    return lines


def rate_figure(rows: Sequence[RateRow]) -> style.ReportFigure:
    """Draw loop times against the rate, with the length of a cycle."""
    rates_hz = [row.rate_hz for row in rows]
    symbols = ["circle" if row.outcome == "clean" else "x" for row in rows]
    lines = []
    for colour, name in zip(style.SCHEMES, ("p50", "p99", "max"), strict=False):
        values_ms = [getattr(row, f"loop_{name}_us") / 1e3 for row in rows]
        line = style.curve(rates_hz, values_ms, f"loop {name}", {"color": colour, "width": 1.8})
        line.update(mode="lines+markers", marker={"symbol": symbols, "size": 9})
        line.hovertemplate = "%{x:g} cycles/s: %{y:.2f} ms"
        lines.append(line)
    cycles_ms = [1e3 / rate_hz for rate_hz in rates_hz]
    dashed = {"color": style.GREY, "width": 1.5, "dash": "dash"}
    length = style.curve(rates_hz, cycles_ms, "length of a cycle", dashed)
    length.hovertemplate = "%{y:.2f} ms"
    figure = style.dress(go.Figure([*lines, length]), _CURVES_PX)
    names = [f"{rate_hz:g}" for rate_hz in rates_hz]
    figure.update_xaxes(type="log", title_text="rate [cycles/s]", tickvals=rates_hz, ticktext=names)
    figure.update_yaxes(type="log", title_text="time [ms]", **_ROUND_TICKS)
    caption = (
        "Time from the plant's scheduled tick to its last command. Circle: a clean rate, at most "
        "1 % of the cycles late and nothing lost. Cross: the plant did not keep up."
    )
    return style.ReportFigure("rates", "Loop time against rate", caption, figure)
