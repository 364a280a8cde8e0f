"""The timing of a run, or of several rates, as one HTML page."""

from __future__ import annotations

from typing import Final

from studies.report.page import html_page
from studies.timing.figures import loop_figure, percentile_figure, rate_figure, waits_figure
from studies.timing.report import Reported, TimingReport
from studies.timing.run_timing import LOOP
from studies.timing.sweep import Sweep, conclusion, machine_lines, sweep_table, trouble_lines
from studies.timing.tables import (
    budgets_table,
    counts_table,
    failures,
    header_lines,
    network_lines,
    processes_table,
    times_tables,
    verdict_line,
)

PAGE_NAME: Final = "timing.html"

_PERCENTILES: Final = (
    ("loop", "Loop time and lateness", (LOOP, "lateness", "response")),
    ("decision", "Decision time by tier", ("decision",)),
    ("hop", "Hop latency by signal", ("hop",)),
)


def run_page(reported: Reported) -> str:
    """Return the page of one run: verdict, slowest cycles, loop time, percentiles, tables."""
    report = reported.report
    first, *machine = header_lines(report)
    missed = failures(report)
    text = [
        *([f"Not kept: {'; '.join(missed)}."] if missed else []),
        f"{first}; {'; '.join(machine)}.",
        *(f"{line}." for line in network_lines(report)),
    ]
    waits = [
        waits_figure(f"waits-{place}", cycle, reported.plan.tree)
        for place, cycle in enumerate(reported.timing.slowest, start=1)
    ]
    curves = [
        percentile_figure(f"percentiles-{name}", heading, rows, report.verdicts)
        for name, heading, measures in _PERCENTILES
        if (rows := [row for row in report.times if row.measure in measures])
    ]
    return html_page(
        f"{report.scenario}: timing of run {report.run_id}",
        text,
        [
            *waits,
            *([loop_figure(reported)] if report.cycles else []),
            *curves,
            *times_tables(report),
            counts_table(report.tiers),
            budgets_table(report.verdicts),
            processes_table(report.processes),
        ],
        verdict=(report.passed, verdict_line(report)),
    )


def sweep_page(found: Sweep, last: TimingReport) -> str:
    """Return the page of a sweep over rates; its last report says what was run."""
    text = [
        *(f"{line}." for line in trouble_lines(found)),
        f"{'; '.join([*machine_lines(found), *last.remarks])}.",
    ]
    # A rate that was interrupted proves nothing.
    drawn = [row for row in found.rows if row.loop_p50_us is not None and not row.interrupted]
    return html_page(
        f"{last.scenario}: loop time against rate",
        text,
        [*([rate_figure(drawn)] if drawn else []), sweep_table(found)],
        verdict=(found.highest_clean_hz is not None, f"{conclusion(found)}."),
    )
