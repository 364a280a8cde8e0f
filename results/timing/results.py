"""The result of a timed run: its lines, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import pandas as pd
import plotly.graph_objects as go

from agents.process.machine_watch import LATE_MS
from results.report import style
from results.report.decimation import extremes
from results.report.result import Result
from results.report.tables import devices_tables
from results.tables import Cell, Column, Table, counted, key_column, word_column
from results.timing.late_cycles import LateCycle
from results.timing.measures import BARS, LOOP, MEASURES, STATISTICS, bins
from results.timing.report import FEW, Budget, TimingReport

_FEW_NOTE: Final = (
    f"of fewer than {FEW} durations the p99 is the longest one, and a single one above the budget "
    "does not decide"
)
_COUNTS: Final = ("missed_deadlines", "missing_inputs", "dropped", "overruns", "skipped_cycles")
_DECIMALS: Final = {"ms": 3, "%": 2, "MB": 1, "": 0}
"""Decimals of a budget's figures, by unit."""

_MOST_LATE: Final = 50
"""Late cycles that a terminal shows one by one; JSON and page have all."""

_LOOP_PX: Final = 440


def cycles_per_s(rate_hz: float) -> str:
    """Say a rate: `20 cycles/s`."""
    return f"{rate_hz:.4g} cycle{'' if rate_hz == 1.0 else 's'}/s"


def timing_result(report: TimingReport, level: str = "tier") -> Result:
    """Return the timing of a run: what was run, how long it took, and whether it was in time.

    The rows of `level` (tier, agent or link) are in the tables; the page has all of them.
    """
    run = report.run
    stopped = f" ({run.late_stopped:,} while the machine stood still)"
    further = [one for one in ("tier", "agent", "link") if one != level]
    return Result(
        f"{run.scenario}: timing of run {run.run_id}",
        [
            *_times_tables(report, level),
            _counts_table(report.tiers),
            *devices_tables(report.devices),
            _other_budgets(report),
            *_late_tables(report.late[:_MOST_LATE], len(report.late)),
        ],
        report.document(),
        lines=[
            f"{run.scenario} at {cycles_per_s(run.rate_hz)} in real time: "
            f"{counted(run.cycles, 'cycle')} in {run.wall_s:.1f} s, {run.late_cycles:,} late"
            f"{stopped if run.late_stopped else ''}"
            f"{', interrupted' if run.interrupted else ''}",
            *host_lines(report),
            *report.remarks,
        ],
        conclusions=[*map(_not_kept, (one for one in report.budgets if not one.passed))],
        verdict=(report.passed, _verdict(report)),
        figures=lambda: [_histograms(report), loop_figure(report)],
        details=[
            *(table for one in further for table in _times_tables(report, one)),
            *(_late_tables(report.late, len(report.late)) if len(report.late) > _MOST_LATE else ()),
        ],
    )


def host_lines(report: TimingReport) -> Iterator[str]:
    """Say what ran, on what, and what was asked of the machine; remarks say what it refused."""
    host = report.host
    asked = [f"SCHED_FIFO {host.priority}" if host.priority else "normal"]
    asked += [f"{who} on CPU {', '.join(map(str, cpus))}" for who, cpus in host.bound_to.items()]
    loads = ""
    if host.load_before is not None and host.load_after is not None:
        loads = f"; load average {host.load_before:.2f} before, {host.load_after:.2f} after"
    yield f"kernel {host.kernel}, {host.cpus} CPUs{loads}"
    yield f"scheduling asked for: {', '.join(asked)}"
    yield f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}"
    if host.stops:  # A process that only sleeps was woken late.
        yield (
            f"the machine stood still for over {LATE_MS:g} ms {counted(host.stops, 'time')}, for "
            f"{host.longest_stop_ms:.1f} ms at most"
        )
    for clock in report.clocks:
        yield (
            f"clock of {clock.host}: {clock.offset_ms:+.3f} ms, known within "
            f"{clock.uncertainty_ms:.3f} ms; hops between hosts are left out"
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


def _other_budgets(report: TimingReport) -> Table:
    columns = (key_column("budget"), Column("measured"), Column("at most"), word_column(""))
    rows = [
        (one.line, _amount(one.value, one.unit), _amount(one.limit, one.unit), one.passed)
        for one in report.budgets
        if not one.measure or one.value is None
    ]
    return Table("Other budgets", columns, rows)


def _times_tables(report: TimingReport, level: str) -> list[Table]:
    """Return a table of durations for each measure, with its budgets."""
    columns = (
        key_column(""),
        Column("count"),
        *(Column(name) for name in STATISTICS),
        word_column("histogram"),
        Column("p99 at most"),
        word_column("budget"),
    )
    limits: dict[object, tuple[Cell, Cell]] = {
        (one.measure, one.of): (one.limit, one.passed) for one in report.budgets
    }
    found = []
    times = report.times[report.times.by == level]
    for measure, own in times.groupby("measure", sort=False):
        rows: list[list[Any]] = []
        for row in own.to_dict("records"):
            figures = [row["of"], row["count"], *(row[f"{name}_ms"] for name in STATISTICS)]
            rows.append([*figures, row["histogram"], *limits.get((measure, row["of"]), (None, ""))])
        edges = bins(own.min_ms.min(), own.max_ms.max())
        notes = [
            MEASURES[str(measure)][0],
            f"histogram: {edges[0]:.3g} to {edges[-1]:.3g} ms, both axes logarithmic",
        ]
        if level == "tier" and (own["count"] < FEW).any():
            notes.append(_FEW_NOTE)
        by = "" if level == "tier" else f" by {level}"
        title = f"{str(measure).capitalize()}{by} [ms]"
        kept = columns if level == "tier" else columns[:-2]
        found.append(Table(title, kept, [row[: len(kept)] for row in rows], notes))
    return found


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


def _late_tables(late: tuple[LateCycle, ...], count: int) -> list[Table]:
    """Return the table of late cycles and that of their culprits."""
    if not late:
        return []
    columns = (key_column("cycle"), Column("loop", "ms", 1), word_column("cause"))
    rows = [(f"{one.cycle:,}", one.loop_ms, one.text) for one in late]
    notes = [f"and {count - len(late):,} more, see --json or --report"] if count > len(late) else []
    by = pd.DataFrame(late).groupby(["culprit", "cause"], sort=False).ms
    summed = by.agg(["size", "max"]).sort_values("size", ascending=False).reset_index()
    culprits = summed.replace(float("inf"), None).to_dict("split")["data"]
    titles = (
        key_column("culprit"),
        key_column("cause"),
        Column("cycles"),
        Column("longest", "ms", 1),
    )
    return [Table("Culprits", titles, culprits), Table("Late cycles", columns, rows, notes)]


def _histograms(report: TimingReport) -> style.ReportFigure:
    """Draw how often each duration occurred, by tier: a line for each row."""
    figure = go.Figure()
    colours = (style.BLUE, style.VERMILLION, style.BLACK)
    for measure, colour in zip(("decision", "hop", "loop"), colours, strict=True):
        times = report.times[(report.times.by == "tier") & (report.times.measure == measure)]
        edges = bins(times.min_ms.min(), times.max_ms.max()) if len(times) else ()
        for row in times.to_dict("records"):
            heights = [BARS.index(bar) for bar in row["histogram"]]
            line = {"color": colour, "width": 1.2, "shape": "hv"}
            curve = style.curve(list(edges[:-1]), heights, f"{measure} {row['of']}", line)
            figure.add_trace(curve)
    figure = style.dress(figure, _LOOP_PX)
    figure.update_xaxes(type="log", title_text="duration [ms]")
    figure.update_yaxes(title_text="frequency, logarithmic", showticklabels=False)
    caption = "How often each duration occurred, by tier; the tables have the numbers."
    return style.ReportFigure("histograms", "Histograms", caption, figure)


def loop_figure(report: TimingReport) -> style.ReportFigure:
    loop_ms = report.loop_ms
    drawn = loop_ms.iloc[extremes(loop_ms.to_numpy())]
    seconds = (drawn.index / report.run.rate_hz).tolist()
    blue, hover = {"color": style.BLUE, "width": 1.2}, "%{x:,.1f} s: %{y:.2f} ms"
    line = style.curve(seconds, drawn.tolist(), "loop time", blue, hovertemplate=hover)
    figure = style.dress(go.Figure(line), _LOOP_PX, legend=False)
    for one in report.budgets:
        if one.line.startswith(f"loop {LOOP}"):
            figure.add_hline(one.limit, line={"color": style.BLACK, "width": 1.3, "dash": "dash"})
    figure.update_xaxes(title_text="time since cycle 0 [s]")
    figure.update_yaxes(type="log", title_text="loop time [ms]")
    caption = "From the plant's scheduled tick to its last command, cycle by cycle. Black: budgets."
    return style.ReportFigure("loop", "Loop time over time", caption, figure)
