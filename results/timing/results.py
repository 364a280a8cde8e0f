"""The result of a timed run: its lines, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from agents.process.machine_watch import LATE_MS
from results.report import style
from results.report.decimation import extremes
from results.report.result import Result
from results.report.tables import devices_tables
from results.tables import Column, Table, counted, key_column, word_column
from results.timing.late_cycles import LateCycle
from results.timing.measures import FEW, LOOP, MEANINGS, STATISTICS, bins
from results.timing.report import Budget, TimingReport

_LEVELS: Final = ("tier", "agent", "link")
_BARS: Final = " ▁▂▃▄▅▆▇█"
_DECIMALS: Final = {"ms": 3, "%": 2, "": 0}
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
    run, late = report.run, report.late
    stopped = sum(one.stopped_ms > 0.0 for one in late)
    facts = f"{counted(run.cycles, 'cycle')} in {run.wall_s:.1f} s, {run.late_cycles:,} late"
    facts += f" ({stopped:,} while the machine stood still)" if stopped else ""
    facts += ", interrupted" if run.interrupted else ""
    further = (table for one in _LEVELS if one != level for table in _times_tables(report, one))
    return Result(
        f"{run.scenario}: timing of run {run.run_id}",
        [
            *_times_tables(report, level),
            _counts_table(report.tiers),
            *devices_tables(report.devices),
            _budgets_table(report.budgets),
            *_late_tables(late, _MOST_LATE),
        ],
        report.document(),
        lines=[
            f"{run.scenario} at {cycles_per_s(run.rate_hz)} in real time: {facts}",
            *host_lines(report),
            *report.remarks,
        ],
        conclusions=[_not_kept(one) for one in report.budgets if not one.passed],
        verdict=(report.passed, _verdict(report)),
        figures=lambda: [_histograms(report), _loop_figure(report)],
        details=[*further, *(_late_tables(late, len(late)) if len(late) > _MOST_LATE else ())],
    )


def host_lines(report: TimingReport) -> Iterator[str]:
    """Say what ran, on what, and what was asked of the machine; remarks say what it refused."""
    host = report.host
    asked = [f"SCHED_FIFO {host['priority']}" if host["priority"] else "normal"]
    asked += [f"{who} on CPU {', '.join(map(str, cpus))}" for who, cpus in host["bound_to"].items()]
    load = ""
    if host["load_after"] is not None:
        load = f"; load average {host['load_before']:.2f} before, {host['load_after']:.2f} after"
    yield f"kernel {host['kernel']}, {host['cpu_count']} CPUs{load}"
    yield f"scheduling asked for: {', '.join(asked)}"
    yield f"Python {host['python']}, heliarch {host['heliarch']}, Zenoh {host['zenoh']}"
    if host["stops"]:  # A process that only sleeps was woken late.
        yield (
            f"the machine stood still for over {LATE_MS:g} ms {counted(host['stops'], 'time')}, "
            f"for {host['longest_stop_ms']:.1f} ms at most"
        )
    if host["time_service"]:
        yield f"clock of this host, says {host['time_service']}"
    for clock in report.clocks:
        yield (
            f"clock of {clock.host}: {clock.offset_ms:+.3f} ms, known within "
            f"{clock.uncertainty_ms:.3f} ms; hops between hosts are left out"
        )


def _verdict(report: TimingReport) -> str:
    run, count = report.run, len(report.budgets)
    failed = sum(not budget.passed for budget in report.budgets)
    kept = f"{failed} of {count} budgets not kept" if failed else f"all {count} budgets were kept"
    if run.ended and not run.interrupted:
        return f"{'PASS' if report.passed else 'FAIL'}: {kept}"
    why = "the run broke off or has not ended yet"
    if run.ended:
        why = f"the run was interrupted after {run.cycles:,} of {run.planned_cycles:,} cycles"
    return f"FAIL: {why}; in the recorded part {kept}"


def _not_kept(budget: Budget) -> str:
    if budget.value is None:
        return f"not kept: {budget.line}: nothing was measured"
    value, limit = (_amount(number, budget.unit) for number in (budget.value, budget.limit))
    return f"not kept: {budget.line} {value} (at most {limit})"


def _amount(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:,.{_DECIMALS[unit]}f} {unit}".rstrip()


def _budgets_table(budgets: Sequence[Budget]) -> Table:
    columns = (key_column("budget"), Column("measured"), Column("at most"), word_column(""))
    rows = [
        (one.line, _amount(one.value, one.unit), _amount(one.limit, one.unit), one.passed)
        for one in budgets
    ]
    note = (
        "a p99 is kept if at most 1 % of the durations exceed it, or a single one of fewer than "
        f"{FEW}: it is the longest of the others"
    )
    return Table("Budgets", columns, rows, [note])


def _times_tables(report: TimingReport, level: str) -> list[Table]:
    """Return a table of durations for each measure."""
    names = [Column(name, name=f"{name}_ms") for name in STATISTICS]
    columns = (key_column("", "of"), Column("count"), *names, word_column("histogram", "bars"))
    times = report.times[report.times.by == level]
    times = times.assign(bars=times.histogram.map(_bars))
    found = []
    for measure, own in times.groupby("measure", sort=False):
        rows = own[[column.name or column.title for column in columns]].to_dict("split")["data"]
        edges, by = bins(own), "" if level == "tier" else f" by {level}"
        scale = f"histogram: {edges[0]:.3g} to {edges[-1]:.3g} ms, both axes logarithmic"
        title = f"{str(measure).capitalize()}{by} [ms]"
        found.append(Table(title, columns, rows, [MEANINGS[str(measure)], scale]))
    return found


def _bars(counts: list[int]) -> str:
    """Return a bar for each bin, its height by the logarithm of the count: one duration is seen."""
    heights = np.log1p(counts) / np.log1p(max(counts)) * (len(_BARS) - 1)
    return "".join(_BARS[int(np.ceil(height))] for height in heights)


def _counts_table(tiers: pd.DataFrame) -> Table:
    columns = (
        key_column("tier"),
        *(Column(name.replace("_", " "), name=name, decimals=0) for name in tiers.columns[1:4]),
        Column("CPU", "% all", 1, name="cpu_percent"),
        Column("CPU", "% most", 1, name="cpu_highest_percent"),
    )
    rows = tiers[[column.name or column.title for column in columns]].to_dict("split")["data"]
    return Table(
        "Counts", columns, rows, ["CPU in % of a core, of all processes and of the busiest"]
    )


def _late_tables(late: Sequence[LateCycle], most: int) -> list[Table]:
    """Return the table of the first late cycles, `most` of them, and that of their culprits."""
    if not late:
        return []
    columns = (key_column("cycle"), Column("loop", "ms", 1), word_column("cause"))
    rows = [(f"{one.cycle:,}", one.loop_ms, one.text) for one in late[:most]]
    more = [f"and {len(late) - most:,} more, see --json or --report"] if len(late) > most else []
    by = pd.DataFrame(late).groupby(["culprit", "cause"], sort=False).ms
    summed = by.agg(["size", "max"]).sort_values("size", ascending=False).reset_index()
    culprits = summed.replace(float("inf"), None).to_dict("split")["data"]
    heads = key_column("culprit"), key_column("cause"), Column("cycles"), Column("longest", "ms", 1)
    return [Table("Culprits", heads, culprits), Table("Late cycles", columns, rows, more)]


def _histograms(report: TimingReport) -> style.ReportFigure:
    """Draw how often each duration occurred, by tier: a line for each row."""
    figure = go.Figure()
    colours = {"decision": style.BLUE, "hop": style.VERMILLION, "loop": style.BLACK}
    times = report.times[(report.times.by == "tier") & report.times.measure.isin(colours)]
    for measure, own in times.groupby("measure", sort=False):
        line = {"color": colours[str(measure)], "width": 1.2, "shape": "hv"}
        for row in own.itertuples():
            name = f"{measure} {row.of}"
            figure.add_trace(style.curve(bins(own)[:-1].tolist(), row.histogram, name, line))
    figure = style.dress(figure, _LOOP_PX)
    figure.update_xaxes(type="log", title_text="duration [ms]")
    figure.update_yaxes(type="log", title_text="count")
    caption = "How often each duration occurred, by tier; the tables have the numbers."
    return style.ReportFigure("histograms", "Histograms", caption, figure)


def _loop_figure(report: TimingReport) -> style.ReportFigure:
    loop_ms = report.loop_ms
    drawn = loop_ms.iloc[extremes(loop_ms.to_numpy())]
    seconds = (drawn.index / report.run.rate_hz).tolist()
    blue, hover = {"color": style.BLUE, "width": 1.2}, "%{x:,.1f} s: %{y:.2f} ms"
    line = style.curve(seconds, drawn.tolist(), "loop time", blue, hovertemplate=hover)
    figure = style.dress(go.Figure(line), _LOOP_PX, legend=False)
    for one in report.budgets:
        if one.of == LOOP:
            figure.add_hline(one.limit, line={"color": style.BLACK, "width": 1.3, "dash": "dash"})
    figure.update_xaxes(title_text="time since cycle 0 [s]")
    figure.update_yaxes(type="log", title_text="loop time [ms]")
    caption = "From the plant's scheduled tick to its last command, cycle by cycle. Black: budget."
    return style.ReportFigure("loop", "Loop time over time", caption, figure)
