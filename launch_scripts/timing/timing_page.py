"""The timing of a run, or of several rates, as one HTML page in the style of the run's report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.rates import cycles_per_s
from launch_scripts.timing.sweep import (
    Sweep,
    conclusion,
    machine_lines,
    rate_figures,
    trouble_lines,
)
from launch_scripts.timing.tiers import TIER_COLUMNS, figure
from launch_scripts.timing.timing_report import Reported, TimingReport
from launch_scripts.timing.timing_table import (
    MEANINGS,
    amount,
    cycle_lines,
    failures,
    header_lines,
    ms,
    network_lines,
    row_name,
    times_cells,
    verdict_cells,
    verdict_line,
)
from recordings.durations import curve_ms
from recordings.report.page import html_page
from recordings.report.style import ReportFigure
from recordings.report.tables import ReportTable
from recordings.report.timing_figures import (
    PercentileCurve,
    RatePoint,
    percentile_curves,
    rate_figure,
    waits_figure,
)
from recordings.timing import LOOP

PAGE_NAME: Final = "timing.html"

_COLUMNS: Final = ("count", "min", "p50", "p99", "p99.9", "max", "p99 at most", "")
_VERDICT: Final = {True: "PASS", False: "FAIL"}

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
    return html_page(title, text, [_rates_table(found), _rates_floor_table(found)], figures)


def page_tables(report: TimingReport) -> list[ReportTable]:
    """Return the tables of a run: durations, counts, other budgets, and each process."""
    return [_times_table(report), _counts_table(report), _budgets_table(report), _processes(report)]


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


def _times_table(report: TimingReport) -> ReportTable:
    rows = [
        (
            f"{row.measure}: {row_name(row)}",
            "ms",
            (*times_cells(row.times), *verdict_cells(row, report.verdicts)),
        )
        for row in report.times
    ]
    rows += [(_floor_name(floor), "ms", (*_floor_cells(floor), "", "")) for floor in report.floor]
    meanings = "; ".join(f"{measure}: {meaning}" for measure, meaning in MEANINGS.items())
    return ReportTable("Durations", _COLUMNS, tuple(rows), f"What they are of. {meanings}.")


def _floor_name(floor: FloorTimes) -> str:
    return f"floor: {floor.name}{', ' if floor.note else ''}{floor.note}"


def _floor_cells(floor: FloorTimes) -> tuple[str, ...]:
    return ("",) * 6 if floor.times is None else times_cells(floor.times)


def _rates_floor_table(found: Sweep) -> ReportTable:
    rows = tuple(
        (f"{_floor_name(floor)}, at {cycles_per_s(row.rate_hz)}", "ms", _floor_cells(floor))
        for row in found.rows
        for floor in row.floor
    )
    text = "What this machine needs by itself, measured beside the plant at the same rate."
    return ReportTable("The machine's floor", _COLUMNS[:6], rows, text)


def _rates_table(found: Sweep) -> ReportTable:
    columns = (
        "cycles",
        "loop p50 [ms]",
        "loop p99 [ms]",
        "loop max [ms]",
        "missed deadlines",
        "overruns",
        "lost messages",
        "CPU [% of a core]",
        "",
    )
    rows = tuple(
        (
            f"{row.rate_hz:.4g}",
            "cycles/s",
            (f"{row.cycles:,}", *rate_figures(row), row.failed or row.outcome),
        )
        for row in found.rows
    )
    return ReportTable("Rates", columns, rows)


def _counts_table(report: TimingReport) -> ReportTable:
    columns = tuple(tier.tier for tier in report.tiers)
    rows = tuple(
        (row.name, row.unit, tuple(row.text(tier) for tier in report.tiers)) for row in TIER_COLUMNS
    )
    return ReportTable("Counts and shares by tier", columns, rows)


def _budgets_table(report: TimingReport) -> ReportTable:
    rows = tuple(
        (
            verdict.line,
            "",
            (
                "nothing" if verdict.value is None else amount(verdict.value, verdict.unit),
                amount(verdict.limit, verdict.unit),
                _VERDICT[verdict.passed],
            ),
        )
        for verdict in report.verdicts
    )
    return ReportTable("Budgets", ("measured", "at most", ""), rows)


def _processes(report: TimingReport) -> ReportTable:
    columns = (
        "slowest decision [ms]",
        "CPU [% of a core]",
        "memory [MB]",
        "waits",
        "missed deadlines",
        "overruns",
        "skipped cycles",
        "dropped",
    )
    rows = tuple(
        (
            process.agent if process.agent == process.tier else f"{process.agent} ({process.tier})",
            "",
            (
                ms(process.slowest_decision_us),
                figure(process.cpu_percent, 1),
                figure(process.resident_mb, 1),
                figure(process.voluntary_switches),
                f"{sum(process.missed_deadlines.values()):,}",
                f"{sum(process.overruns.values()):,}",
                f"{process.skipped_cycles:,}",
                figure(None if process.dropped is None else sum(process.dropped.values())),
            ),
        )
        for process in report.processes
    )
    return ReportTable("Processes", columns, rows)
