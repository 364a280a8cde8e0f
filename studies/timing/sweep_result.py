"""The result of a sweep over rates: its table, its figure, and how fast the plant can go."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from results.report import style
from results.report.result import Result
from results.tables import Cell, Column, Table, key_column, word_column
from results.timing.results import CURVES_PX, ROUND_TICKS
from results.timing.tables import cycles_per_s, host_lines
from studies.timing.sweep import RateRow, Sweep


def sweep_result(done: Sweep, scenario: str) -> Result:
    """Return the rates, the machine, and the highest clean rate."""
    ran = [row for row in done.rows if row.outcome in {"clean", "not clean"}]
    drawn = [row for row in ran if row.loop_p50_us is not None]
    hosts = [row.host for row in done.rows if row.host is not None]
    reasons = [
        f"{cycles_per_s(row.rate_hz)} {row.outcome}: {row.reason}"
        for row in done.rows
        if row.reason
    ]
    return Result(
        f"{scenario}: loop time against rate",
        [sweep_table(done)],
        done,
        lines=host_lines(hosts[-1]) if hosts else [],
        conclusions=reasons,
        verdict=(done.highest_clean_hz is not None, conclusion(done)),
        figures=lambda: [rate_figure(drawn)] if drawn else [],
    )


def sweep_table(done: Sweep) -> Table:
    columns = (
        key_column("rate"),
        Column("cycles"),
        Column("cycle", "ms", 2),
        Column("loop p50", "ms"),
        Column("loop p99", "ms"),
        Column("loop max", "ms"),
        *map(Column, ("late cycles", "lost")),
        word_column(""),
    )
    rows: list[tuple[Cell, ...]] = []
    for row in done.rows:
        loop_us = (row.loop_p50_us, row.loop_p99_us, row.loop_max_us)
        loop_ms = (None if value_us is None else value_us / 1e3 for value_us in loop_us)
        rate, cycle_ms = f"{row.rate_hz:.4g}", 1e3 / row.rate_hz
        counts = (row.late_cycles, row.lost_messages)
        rows.append((rate, row.cycles, cycle_ms, *loop_ms, *counts, row.outcome))
    return Table("Rates [cycles/s]", columns, tuple(rows))


def conclusion(done: Sweep) -> str:
    """Say how fast the plant can go."""
    if done.highest_clean_hz is not None:
        at_least = "at least " if done.too_fast_hz is None else ""
        return (
            f"highest clean rate: {at_least}{cycles_per_s(done.highest_clean_hz)} (at most 1 % of "
            "the cycles late, no message lost)"
        )
    if done.interrupted:
        return "interrupted before a rate was found to be clean"
    return f"no rate was clean: {len(done.rows)} tried, try lower ones"


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
    figure = style.dress(go.Figure([*lines, length]), CURVES_PX)
    names = [f"{rate_hz:g}" for rate_hz in rates_hz]
    figure.update_xaxes(type="log", title_text="rate [cycles/s]", tickvals=rates_hz, ticktext=names)
    figure.update_yaxes(type="log", title_text="time [ms]", **ROUND_TICKS)
    caption = (
        "Time from the plant's scheduled tick to its last command. Circle: a clean rate, at most "
        "1 % of the cycles late and nothing lost. Cross: the plant did not keep up."
    )
    return style.ReportFigure("rates", "Loop time against rate", caption, figure)
