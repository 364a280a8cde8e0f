"""The result of a timed run: its lines, tables and figures."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from bus_schemas.tree import CENTRAL, PLANT
from results.report import style
from results.report.decimation import extremes
from results.report.result import Result
from results.report.tables import devices_tables
from results.tables import Cell, Column, Table, counted, key_column, word_column
from results.timing.cycle_waits import CycleWaits
from results.timing.report import FEW, Budget, TimingReport
from results.timing.run_timing import WHOLE_LOOP

_MEANINGS: Final = {
    "loop": "from the plant's scheduled tick to its last command; each command: to its publishing",
    "decision": "from the moment when a stage could close to its last message",
    "hop": "from the publishing of the input that completed a stage to when the stage could close",
    "lateness": "from the scheduled time of what the clock closes to its first message",
    "age": "from the publishing of the oldest input to when the stage could close",
    "response": "from the last input to the device's own last message, seen from outside",
}
"""What each measure is, in a few words; docs/timing.md has the definitions."""

_FEW_NOTE: Final = (
    f"of fewer than {FEW} durations the p99 is the longest one, and a single one above the budget "
    "does not decide"
)
_HOPS: Final = (
    "(each time begins when the agent's last input was published, so it includes the hop)"
)
_STATISTICS: Final = {"min": "min_us", "p50": "p50_us", "p99": "p99_us", "p99.9": "p99_9_us"} | {
    "max": "max_us"
}
_COUNTS: Final = ("missed_deadlines", "missing_inputs", "dropped", "overruns", "skipped_cycles")
_DECIMALS: Final = {"ms": 3, "%": 2, "MB": 1, "": 0}
"""Decimals of a budget's figures, by unit."""

_LOOP_PX: Final = 440
_ROW_PX: Final = 17
_FRAME_PX: Final = 120


def cycles_per_s(rate_hz: float) -> str:
    """Say a rate: `20 cycles/s`."""
    return f"{rate_hz:.4g} cycle{'' if rate_hz == 1.0 else 's'}/s"


def timing_result(report: TimingReport) -> Result:
    """Return the timing of a run: what was run, how long it took, and whether it was in time."""
    run = report.run
    stopped = f" ({run.late_stopped:,} while the machine stood still)"
    slowest = [
        f"{'next' if number else 'slowest'} {one.in_words()}"
        for number, one in enumerate(report.slowest)
    ]
    unkept = [one for one in report.budgets if not one.passed]
    return Result(
        f"{run.scenario}: timing of run {run.run_id}",
        _tables(report),
        report.document(),
        lines=[
            f"{run.scenario} at {cycles_per_s(run.rate_hz)} in real time: "
            f"{counted(run.cycles, 'cycle')} in {run.wall_s:.1f} s, {run.late_cycles:,} late"
            f"{stopped if run.late_stopped else ''}"
            f"{', interrupted' if run.interrupted else ''}",
            *report.host,
            *report.remarks,
        ],
        conclusions=[*slowest, *([_HOPS] if slowest else []), *map(_not_kept, unkept)],
        verdict=(report.passed, _verdict(report)),
        figures=lambda: [
            *(waits_figure(f"waits-{at}", one) for at, one in enumerate(report.slowest, start=1)),
            *([loop_figure(report)] if run.cycles else []),
        ],
    )


def _verdict(report: TimingReport) -> str:
    """Return the verdict on the whole run."""
    run, count = report.run, len(report.budgets)
    failed = sum(not budget.passed for budget in report.budgets)
    if not run.whole:
        why = "the run broke off or has not ended yet"
        if run.ended:
            why = f"the run was interrupted after {run.cycles:,} of {run.planned_cycles:,} cycles"
        return f"FAIL: {why}; in the recorded part {failed} of {count} budgets not kept"
    if failed:
        return f"FAIL: {failed} of {count} budgets not kept"
    return f"PASS: all {count} budgets were kept"


def _not_kept(budget: Budget) -> str:
    if budget.value is None:
        return f"not kept: {budget.line}: nothing was measured"
    value, limit = (_amount(number, budget.unit) for number in (budget.value, budget.limit))
    return f"not kept: {budget.line} {value} (at most {limit})"


def _amount(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:,.{_DECIMALS[unit]}f} {unit}".rstrip()


def _tables(report: TimingReport) -> list[Table]:
    """Return all tables: durations by measure, counts, health, and the other budgets."""
    columns = (key_column("budget"), Column("measured"), Column("at most"), word_column(""))
    rows = [
        (one.line, _amount(one.value, one.unit), _amount(one.limit, one.unit), one.passed)
        for one in report.budgets
        if not one.measure or one.value is None
    ]
    return [
        *_times_tables(report),
        _counts_table(report.tiers),
        *devices_tables(report.devices),
        Table("Other budgets", columns, rows),
    ]


def _times_tables(report: TimingReport) -> list[Table]:
    """Return a table of durations for each measure, with its budgets."""
    columns = (
        key_column(""),
        Column("count"),
        *map(Column, _STATISTICS),
        Column("p99 at most"),
        word_column("budget"),
    )
    limits: dict[object, tuple[Cell, Cell]] = {
        (one.measure, one.of): (one.limit, one.passed) for one in report.budgets
    }
    rows: dict[str, list[list[Any]]] = {}
    for row in report.times.to_dict("records"):
        figures = [row["count"], *(row[name] / 1e3 for name in _STATISTICS.values())]
        limit = limits.get((row["measure"], row["of"]), (None, ""))
        rows.setdefault(row["measure"], []).append([row["of"], *figures, *limit])
    return [
        Table(
            f"{measure.capitalize()} [ms]",
            columns,
            own,
            [_MEANINGS[measure], *([_FEW_NOTE] if any(row[1] < FEW for row in own) else [])],
        )
        for measure, own in rows.items()
    ]


def _counts_table(tiers: pd.DataFrame) -> Table:
    columns = (
        key_column("tier"),
        Column("number", name="processes"),
        *(Column(name.replace("_", " "), name=name, decimals=0) for name in _COUNTS),
        Column("CPU", "% all", 1, name="cpu_percent"),
        Column("CPU", "% most", 1, name="cpu_highest_percent"),
        Column("memory", "MB", 1, name="resident_mb"),
    )
    rows = tiers[[column.name or column.title for column in columns]].to_dict("split")["data"]
    note = "CPU in % of one core, of all processes and of the busiest; memory of the largest one"
    return Table("Counts", columns, rows, [note])


def waits_figure(anchor: str, cycle: CycleWaits) -> style.ReportFigure:
    """Draw who waited for whom in a cycle: a row for each agent, in the order of the tree."""
    rows = [PLANT, CENTRAL, *sorted({*cycle.waits.agent} - {PLANT, CENTRAL})]
    waits = pd.concat([cycle.waits[~cycle.waits.index.isin(cycle.chain.index)], cycle.chain])
    in_chain = waits.index.isin(cycle.chain.index)
    texts = waits.text + ", after " + waits.cause.replace("", "the tick")
    bars = go.Bar(
        orientation="h",
        y=waits.agent.tolist(),
        base=waits.began_ms.tolist(),
        x=(waits.ended_ms - waits.began_ms).tolist(),
        marker={"color": np.where(in_chain, style.VERMILLION, style.faint(style.BLUE, 0.35))},
        customdata=texts.map(style.plain).tolist(),
        hovertemplate="%{customdata}<extra></extra>",
    )
    figure = style.dress(go.Figure(bars), _FRAME_PX + _ROW_PX * len(rows), legend=False)
    figure.update_layout(barmode="overlay", bargap=0.25)
    order = {"categoryorder": "array", "categoryarray": rows, "range": [len(rows) - 0.4, -0.6]}
    figure.update_yaxes(**order, tickfont={"size": 11}, automargin=True, showgrid=False, dtick=1)
    figure.update_xaxes(title_text="time after the plant's scheduled tick [ms]", rangemode="tozero")
    return style.ReportFigure(
        anchor,
        f"Who waited for whom in cycle {cycle.cycle:,}",
        "A bar begins when the last input that an agent waited for was published and ends with "
        "the agent's last message of that stage; it includes the hop. Orange: the chain from the "
        "tick to the plant's production; the other bars did not delay the cycle. "
        f"{cycle.in_words().capitalize()}.",
        figure,
    )


def loop_figure(report: TimingReport) -> style.ReportFigure:
    loop_ms = report.loop_ms
    drawn = loop_ms.iloc[extremes(loop_ms.to_numpy())]
    seconds = (drawn.index / report.run.rate_hz).tolist()
    blue, hover = {"color": style.BLUE, "width": 1.2}, "%{x:,.1f} s: %{y:.2f} ms"
    line = style.curve(seconds, drawn.tolist(), "loop time", blue, hovertemplate=hover)
    figure = style.dress(go.Figure(line), _LOOP_PX, legend=False)
    for one in report.budgets:
        if one.line.startswith(f"loop {WHOLE_LOOP}"):
            figure.add_hline(one.limit, line={"color": style.BLACK, "width": 1.3, "dash": "dash"})
    figure.update_xaxes(title_text="time since cycle 0 [s]")
    figure.update_yaxes(type="log", title_text="loop time [ms]")
    caption = "From the plant's scheduled tick to its last command, cycle by cycle. Black: budgets."
    return style.ReportFigure("loop", "Loop time over time", caption, figure)
