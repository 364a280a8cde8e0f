"""The timing of a run, or of several rates, as one HTML page in the style of the run's report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from studies.report.page import html_page
from studies.report.style import ReportFigure
from studies.report.tables import ReportTable
from studies.timing.durations import curve_ms
from studies.timing.figure_tables import Column, FigureTable, page_table
from studies.timing.figures import (
    PercentileCurve,
    RatePoint,
    percentile_curves,
    rate_figure,
    waits_figure,
)
from studies.timing.report import Reported, TimingReport
from studies.timing.run_timing import LOOP
from studies.timing.sweep import (
    Sweep,
    conclusion,
    machine_lines,
    sweep_tables,
    trouble_lines,
)
from studies.timing.table import (
    budgets_table,
    counts_table,
    cycle_lines,
    failures,
    header_lines,
    ms,
    network_lines,
    row_name,
    times_tables,
    verdict_line,
)
from studies.timing.tiers import figure

PAGE_NAME: Final = "timing.html"

_CAPTION: Final = (
    "Each step to the right leaves a tenth of the durations: at 99 % one in a hundred is longer. "
    "Grey: what this machine needs by itself, measured beside the plant at the same rate."
)

_FIGURES: Final = (
    ("loop", "Loop time and lateness", (LOOP, "lateness", "response")),
    ("decision", "Decision time by tier", ("decision",)),
    ("hop", "Hop latency by signal", ("hop",)),
)


def run_page(reported: Reported) -> str:
    """Return the page of one run."""
    report = reported.report
    title = f"{report.scenario}: timing of run {report.run_id}"
    waits = [
        waits_figure(f"waits-{place}", cycle, reported.plan.tree)
        for place, cycle in enumerate(reported.slowest, start=1)
    ]
    first, *machine = header_lines(report)
    text = [
        f"{first}.",
        f"{'; '.join([verdict_line(report), *failures(report)])}.",
        f"{'; '.join(machine)}.",
        *(f"{line}." for line in (*cycle_lines(report), *network_lines(report))),
    ]
    return html_page(title, text, page_tables(report), [*percentile_figures(report), *waits])


def sweep_page(found: Sweep, last: TimingReport) -> str:
    """Return the page of a sweep over rates. The last report says of what the runs were."""
    points = [
        RatePoint(
            row.rate_hz,
            row.loop_p50_us / 1e3,
            row.loop_p99_us / 1e3,
            row.loop_max_us / 1e3,
            row.clean,
        )
        for row in found.rows
        if not row.interrupted  # It proves nothing, so the figure leaves it out.
        and row.loop_p50_us is not None
        and row.loop_p99_us is not None
        and row.loop_max_us is not None
    ]
    text = [
        f"{conclusion(found)}.",
        *(f"{line}." for line in trouble_lines(found)),
        f"{'; '.join([*machine_lines(found), *last.remarks])}.",
    ]
    title = f"{last.scenario}: loop time against rate"
    figures = [rate_figure(points)] if points else []
    return html_page(title, text, [page_table(table) for table in sweep_tables(found)], figures)


def page_tables(report: TimingReport) -> list[ReportTable]:
    """Return the tables of a run: durations, counts, other budgets, and each process."""
    tables = (
        *times_tables(report),
        counts_table(report.tiers),
        budgets_table(report.verdicts),
        _processes_table(report),
    )
    return [page_table(table) for table in tables]


def percentile_figures(report: TimingReport) -> list[ReportFigure]:
    """Return the distributions, a figure for each kind of measure, the floor in each."""
    return [
        percentile_curves(f"percentiles-{name}", heading, _CAPTION, curves)
        for name, heading, measures in _FIGURES
        if (curves := _curves(report, measures))
    ]


def _curves(report: TimingReport, measures: Sequence[str]) -> list[PercentileCurve]:
    named = len(measures) > 1
    curves = [
        PercentileCurve(
            f"{row.measure} {row_name(row)}" if named else row_name(row), *curve_ms(row.times)
        )
        for row in report.times
        if row.measure in measures
    ]
    floor = [
        PercentileCurve(f"floor: {entry.name}", *curve_ms(entry.times), floor=True)
        for entry in report.floor
        if entry.times is not None
    ]
    return curves + floor if curves else []


def _processes_table(report: TimingReport) -> FigureTable:
    headings = (
        "slowest decision [ms]",
        "CPU [% of a core]",
        "memory [MB]",
        "waits",
        "missed deadlines",
        "overruns",
        "skipped cycles",
        "dropped",
    )
    rows = [
        (
            process.agent if process.agent == process.tier else f"{process.agent} ({process.tier})",
            ms(process.slowest_decision_us),
            figure(process.cpu_percent, 1),
            figure(process.resident_mb, 1),
            figure(process.voluntary_switches),
            f"{sum(process.missed_deadlines.values()):,}",
            f"{sum(process.overruns.values()):,}",
            f"{process.skipped_cycles:,}",
            figure(None if process.dropped is None else sum(process.dropped.values())),
        )
        for process in report.processes
    ]
    return FigureTable("processes", "", [Column(heading, 0) for heading in headings], rows)
