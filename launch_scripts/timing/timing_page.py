"""The timing of a run, or of several rates, as one HTML page in the style of the run's report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from bus_schemas.tree import ControlTree
from launch_scripts.timing.distributions import curve_ms
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.measures import LOOP, Times
from launch_scripts.timing.rates import cycles_per_s
from launch_scripts.timing.sweep import Sweep, conclusion, machine_lines, trouble_lines
from launch_scripts.timing.tier_columns import TIER_COLUMNS
from launch_scripts.timing.timing_report import TimingReport
from launch_scripts.timing.timing_table import (
    MEANINGS,
    amount,
    cycle_lines,
    failure,
    header_lines,
    network_lines,
    percentiles,
    row_name,
    verdict_line,
)
from recordings.cycle_waits import CycleWaits
from recordings.report.page import html_page
from recordings.report.run_report import write_whole
from recordings.report.style import ReportFigure
from recordings.report.tables import ReportTable
from recordings.report.timing_figures import (
    PercentileCurve,
    RatePoint,
    percentile_curves,
    rate_figure,
    waits_figure,
)

PAGE_NAME: Final = "timing.html"

_COLUMNS: Final = ("count", "min", "p50", "p99", "p99.9", "max", "p99 at most", "")
_FLOOR_COLUMNS: Final = _COLUMNS[:6]
_VERDICT: Final = {True: "PASS", False: "FAIL"}

_CAPTION: Final = (
    "Each step to the right leaves a tenth of the durations: at 99 % one in a hundred is longer. "
    "Grey: what this machine needs by itself, measured beside the plant at the same rate."
)


def write_page(
    path: Path, report: TimingReport, slowest: Sequence[CycleWaits], tree: ControlTree
) -> None:
    """Write the page of one run.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    title = f"{report.scenario}: timing of run {report.run_id}"
    figures = [
        *percentile_figures(report),
        *(
            waits_figure(f"waits-{place}", cycle, tree)
            for place, cycle in enumerate(slowest, start=1)
        ),
    ]
    first, *machine = header_lines(report)
    text = [
        f"{first}.",
        f"{'; '.join([verdict_line(report), *_failures(report)])}.",
        f"{'; '.join(machine)}.",
        *(f"{line}." for line in cycle_lines(report)),
        *(f"{line}." for line in network_lines(report)),
    ]
    write_whole(path, html_page(title, text, page_tables(report), figures))


def write_sweep_page(path: Path, found: Sweep, last: TimingReport) -> None:
    """Write the page of a sweep over rates.

    Parameters
    ----------
    path
        The file.
    found
        What the plant came to at each rate.
    last
        The report of one of the runs: it says of what they were, and names what is to be known.

    Raises
    ------
    InputError
        The file cannot be written.
    """
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
    tables = [_rates_table(found), _rates_floor_table(found)]
    write_whole(path, html_page(title, text, tables, figures))


def page_tables(report: TimingReport) -> list[ReportTable]:
    """Return the tables of a run: durations, counts, other budgets, and each process."""
    return [_times_table(report), _counts_table(report), _budgets_table(report), _processes(report)]


def percentile_figures(report: TimingReport) -> list[ReportFigure]:
    """Return the distributions, a figure for each kind of measure, the floor in each."""
    return [
        percentile_curves(f"percentiles-{name}", heading, _CAPTION, curves)
        for name, heading, measures in (
            ("loop", "Loop time and lateness", (LOOP, "lateness", "response")),
            ("decision", "Decision time by tier", ("decision",)),
            ("hop", "Hop latency by signal", ("hop",)),
        )
        if (curves := _curves(report, measures))
    ]


def _curves(report: TimingReport, measures: Sequence[str]) -> list[PercentileCurve]:
    rows = [row for row in report.times if row.measure in measures]
    curves = [PercentileCurve(_name(row), *curve_ms(row.times)) for row in rows]
    floor = [
        PercentileCurve(f"floor: {entry.name}", *curve_ms(entry.times), floor=True)
        for entry in report.floor
        if entry.times is not None
    ]
    return curves + floor if curves else []


def _name(row: Times) -> str:
    return row_name(row) if row.measure in {"decision", "hop"} else f"{row.measure} {row_name(row)}"


def _times_table(report: TimingReport) -> ReportTable:
    verdicts = {(entry.measure, entry.of): entry for entry in reversed(report.verdicts)}
    rows = []
    for row in report.times:
        verdict = verdicts.get((row.measure, row.of))
        judged = ("", "") if verdict is None else (_ms(verdict.limit), _VERDICT[verdict.passed])
        figures = (f"{row.times.count:,}", *_figures(percentiles(row.times)), *judged)
        rows.append((f"{row.measure}: {row_name(row)}", "ms", figures))
    for floor in report.floor:
        rows.append((_floor_name(floor), "ms", (*_floor_figures(floor), "", "")))
    meanings = "; ".join(f"{measure}: {meaning}" for measure, meaning in MEANINGS.items())
    return ReportTable("Durations", _COLUMNS, tuple(rows), f"What they are of. {meanings}.")


def _floor_name(floor: FloorTimes) -> str:
    return f"floor: {floor.name}{', ' if floor.note else ''}{floor.note}"


def _floor_figures(floor: FloorTimes) -> tuple[str, ...]:
    if floor.times is None:
        return ("",) * len(_FLOOR_COLUMNS)
    return f"{floor.times.count:,}", *_figures(percentiles(floor.times))


def _rates_floor_table(found: Sweep) -> ReportTable:
    rows = tuple(
        (f"{_floor_name(floor)}, at {cycles_per_s(row.rate_hz)}", "ms", _floor_figures(floor))
        for row in found.rows
        for floor in row.floor
    )
    text = "What this machine needs by itself, measured beside the plant at the same rate."
    return ReportTable("The machine's floor", _FLOOR_COLUMNS, rows, text)


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
            (
                f"{row.cycles:,}",
                *(
                    "-" if value_us is None else _ms(value_us / 1e3)
                    for value_us in (row.loop_p50_us, row.loop_p99_us, row.loop_max_us)
                ),
                f"{row.missed_deadlines:,}",
                f"{row.overruns:,}",
                f"{row.lost_messages:,}",
                f"{row.cpu_percent:.0f}",
                row.failed or row.outcome,
            ),
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


def _failures(report: TimingReport) -> list[str]:
    return [failure(verdict) for verdict in report.verdicts if not verdict.passed]


def _processes(report: TimingReport) -> ReportTable:
    columns = (
        "slowest decision [ms]",
        "CPU [% of a core]",
        "memory [MB]",
        "times preempted",
        "missed deadlines",
        "overruns",
        "cycles given up",
        "dropped",
    )
    rows = tuple(
        (
            process.agent if process.agent == process.tier else f"{process.agent} ({process.tier})",
            "",
            (
                _ms(
                    max(
                        (row.times.max_us for row in process.times if row.measure == "decision"),
                        default=0.0,
                    )
                    / 1e3
                ),
                f"{process.cpu_percent:.1f}",
                f"{process.resident_mb:.1f}",
                f"{process.switches_involuntary:,}",
                f"{sum(process.missed_deadlines.values()):,}",
                f"{sum(process.overruns.values()):,}",
                f"{process.cycles_given_up:,}",
                f"{sum(process.dropped.values()):,}",
            ),
        )
        for process in report.processes
    )
    return ReportTable("Processes", columns, rows)


def _figures(values_us: Sequence[float]) -> list[str]:
    return [_ms(value_us / 1e3) for value_us in values_us]


def _ms(value_ms: float) -> str:
    return f"{value_ms:,.3f}"
