"""The timing of a run as tables and lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from results.report.tables import devices_tables
from results.tables import (
    Cell,
    Column,
    Table,
    attributes,
    counted,
    key_column,
    texts_table,
    word_column,
)
from results.timing.budgets import Verdict
from results.timing.clocks import ClockOffset
from results.timing.report import Host, TimingReport
from results.timing.run_timing import Distribution, ProcessTiming

MEANINGS: Final = {
    "loop": "from the plant's scheduled tick to its last command; each command: to its publishing",
    "decision": "from the moment when a stage could close to its last message",
    "hop": "from the publishing of the input that completed a stage to when the stage could close",
    "lateness": "from the scheduled time of what the clock closes to its first message",
    "jitter": "how much the time between two first messages differs from the cycles between them",
    "age": "from the publishing of the oldest input to when the stage could close",
    "response": "from the last input to the device's own last message, seen from outside",
}
"""What each measure is, in a few words; docs/timing.md has the definitions."""

_STATISTICS: Final = tuple(Column(name) for name in ("min", "p50", "p99", "p99.9", "max"))
_LIMITS: Final = (Column("p99 at most"), word_column("budget"))
_TIMES: Final = (key_column(""), Column("count"), *_STATISTICS, *_LIMITS)

_COUNTS: Final = (
    Column("missed deadlines", name="missed_deadlines"),
    Column("missing inputs", name="missing_inputs"),
    Column("dropped"),
    Column("overruns"),
    Column("skipped cycles", name="skipped_cycles"),
)
_MEMORY: Final = Column("memory", "MB", 1, name="resident_mb")
_TIER_COLUMNS: Final = (
    key_column("tier"),
    Column("number", name="processes"),
    *_COUNTS,
    Column("CPU", "% all", 1, name="cpu_percent"),
    Column("CPU", "% most", 1, name="cpu_highest_percent"),
    _MEMORY,
)
_PROCESS_COLUMNS: Final = (
    key_column("process", "agent"),
    word_column("tier"),
    *_COUNTS,
    Column("CPU", "%", 1, name="cpu_percent"),
    _MEMORY,
)
_TIER_NOTE: Final = (
    "CPU in % of one core, of all processes and of the busiest; memory of the largest one"
)
_DECIMALS: Final = {"ms": 3, "%": 2, "MB": 1, "": 0}
"""Decimals of a budget's figures, by unit."""


def cycles_per_s(rate_hz: float) -> str:
    """Say a rate: `20 cycles/s`."""
    return f"{rate_hz:.4g} cycle{'' if rate_hz == 1.0 else 's'}/s"


def header_lines(report: TimingReport) -> list[str]:
    """Return what was run, and on which machine."""
    return [
        f"{report.scenario} at {cycles_per_s(report.rate_hz)} in real time: "
        f"{counted(report.cycles, 'cycle')} in {report.wall_s:.1f} s, {report.late_cycles:,} late"
        f"{', interrupted' if report.interrupted else ''}",
        *host_lines(report.host),
        *report.remarks,
    ]


def host_lines(host: Host) -> list[str]:
    """Return the machine and the software of a run."""
    load = ""
    if host.load_before is not None and host.load_after is not None:
        load = f"; load average {host.load_before:.2f} before, {host.load_after:.2f} after"
    return [
        f"kernel {host.kernel}, {host.cpus} CPUs{load}",
        f"scheduling asked for: {host.scheduling}",
        f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}",
    ]


def verdict_line(report: TimingReport) -> str:
    """Return the verdict on the whole run."""
    failed = len(failures(report))
    if not report.ended:
        return (
            "FAIL: the run broke off or has not ended yet; in the recorded part "
            f"{failed} of {len(report.verdicts)} budgets not kept"
        )
    if not failed:
        return f"PASS: all {len(report.verdicts)} budgets were kept"
    return f"FAIL: {failed} of {len(report.verdicts)} budgets not kept"


def failures(report: TimingReport) -> list[str]:
    """Return the budgets that were not kept, with what was measured."""
    return [
        f"{verdict.line}: nothing was measured"
        if verdict.value is None
        else f"{verdict.line} {_amount(verdict.value, verdict.unit)} "
        f"(at most {_amount(verdict.limit, verdict.unit)})"
        for verdict in report.verdicts
        if not verdict.passed
    ]


def _amount(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:,.{_DECIMALS[unit]}f} {unit}".rstrip()


def measured_tables(report: TimingReport) -> list[Table]:
    """Return all tables: durations by measure, counts, health, and the other budgets."""
    return [
        *_times_tables(report),
        *_clocks_tables(report.clocks),
        Table("Counts", _TIER_COLUMNS, attributes(report.tiers, _TIER_COLUMNS), [_TIER_NOTE]),
        *devices_tables(report.devices),
        *_processes_tables(report.processes),
        texts_table("Health of the run", report.health),
        budgets_table(report.verdicts),
    ]


def _processes_tables(processes: Sequence[ProcessTiming]) -> list[Table]:
    """Return the counts of each process, if they have rows of their own."""
    rows = attributes((one for one in processes if one.times), _PROCESS_COLUMNS)
    return [Table("Processes", _PROCESS_COLUMNS, rows)] if rows else []


def _times_tables(report: TimingReport) -> list[Table]:
    """Return a table of durations for each measure, with its budgets.

    Rows of single processes come below those of all together.
    """
    limits: dict[tuple[str, str], tuple[Cell, Cell]] = {
        (verdict.measure, verdict.of): (verdict.limit, verdict.passed)
        for verdict in report.verdicts
        if verdict.line.endswith("p99")
    }
    rows: dict[str, list[tuple[Cell, ...]]] = {}
    for row in report.times:
        limit = limits.get((row.measure, row.of), (None, ""))
        rows.setdefault(row.measure, []).append((row.of, *_figures(row.times), *limit))
    for process in report.processes:
        for row in process.times:
            name = f"{process.agent}: {row.of}"
            rows.setdefault(row.measure, []).append((name, *_figures(row.times), None, ""))
    return [
        Table(f"{measure.capitalize()} [ms]", _TIMES, found, [MEANINGS[measure]])
        for measure, found in rows.items()
    ]


def _figures(times: Distribution) -> tuple[Cell, ...]:
    statistics_us = (times.min_us, times.p50_us, times.p99_us, times.p99_9_us, times.max_us)
    return (times.count, *(value_us / 1e3 for value_us in statistics_us))


def _clocks_tables(clocks: Sequence[ClockOffset]) -> list[Table]:
    """Return the clocks of other hosts and devices, if there are any."""
    columns = (
        key_column("clock of"),
        Column("agents"),
        Column("ahead", "ms", 3),
        Column("±", "ms", 3),
    )
    rows = tuple(
        (one.name, len(one.agents), one.ahead_us / 1e3, one.within_us / 1e3) for one in clocks
    )
    notes = (
        "ahead of the plant's clock, by the fastest messages each way;",
        "± is half their round trip, the largest error if one way is slower than the other;",
        "a hop marked * is between two clocks",
    )
    return [Table("Clocks", columns, rows, notes)] if rows else []


def budgets_table(verdicts: Iterable[Verdict]) -> Table:
    """Return the budgets that no row of the durations shows."""
    columns = (key_column("budget"), Column("measured"), Column("at most"), word_column(""))
    rows = tuple(
        (one.line, _amount(one.value, one.unit), _amount(one.limit, one.unit), one.passed)
        for one in verdicts
        if not one.measure or one.value is None or not one.line.endswith("p99")
    )
    return Table("Other budgets", columns, rows)
