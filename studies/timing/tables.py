"""The timing of a run as tables and lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import msgspec

from studies.report.tables import devices_tables
from studies.tables import (
    Cell,
    Column,
    Table,
    attributes,
    counted,
    key_column,
    word_column,
)
from studies.timing.budgets import Verdict
from studies.timing.clocks import ACROSS, ClockOffset
from studies.timing.durations import Distribution, Times
from studies.timing.report import Host, TimingReport
from studies.timing.run_timing import ProcessTiming, count_of

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
_TIMES: Final = (key_column(""), Column("count"), *_STATISTICS)
_JUDGED: Final = (*_TIMES, Column("p99 at most"), word_column("budget"))

_TIER_COLUMNS: Final = (
    key_column("tier"),
    Column("number", name="processes"),
    Column("missed deadlines", name="missed_deadlines"),
    Column("missing inputs", name="missing_inputs"),
    Column("old inputs", name="old_inputs"),
    Column("dropped"),
    Column("overruns"),
    Column("skipped cycles", name="skipped_cycles"),
    Column("CPU", "% all", 1, name="cpu_percent"),
    Column("CPU", "% most", 1, name="cpu_highest_percent"),
    Column("memory", "MB", 1, name="resident_mb"),
)
_TIER_NOTE: Final = (
    "CPU in % of one core, of all processes and of the busiest; memory of the largest one"
)
_ACROSS: Final = "* between two clocks: worked out from both, see the table of clocks"
_MOST_WRONG: Final = 12
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
    lines = [
        f"kernel {host.kernel}",
        f"{host.cpus} CPUs{load}",
        f"scheduling: {host.scheduling}",
        f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}",
    ]
    if host.load_before is not None and host.load_before > host.cpus:
        lines.append(
            "the machine was busy before the run began: more processes were running than it has "
            "processors"
        )
    return lines


def network_lines(report: TimingReport) -> list[str]:
    """Say what external agents sent, what of it was wrong, and what faults did to messages."""
    lines = [
        f"external {account.agent}: answered {counted(account.answered, 'time')} of "
        f"{account.expected:,}; gaps in its sequence numbers show {account.lost:,} messages that "
        "never came or could not be decoded"
        for account in report.external
    ]
    lines += [
        f"wrong {entry.key}, {counted(entry.count, 'time')}: {entry.cause}: {entry.example}"
        for entry in report.wrong[:_MOST_WRONG]
    ]
    if report.faults:
        counts = ", ".join(f"{count:,} {name}" for name, count in report.faults.items())
        lines.append(f"network faults that were asked for: {counts}")
    return lines


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
    """Return the tables of durations, clocks, counts and devices."""
    return [
        *_times_tables(report),
        *_clocks_tables(report.clocks),
        Table("Counts", _TIER_COLUMNS, attributes(report.tiers, _TIER_COLUMNS), [_TIER_NOTE]),
        *devices_tables(report.devices),
    ]


def _times_tables(report: TimingReport) -> list[Table]:
    """Return a table of durations for each measure, with its budgets if it has any.

    Rows of single processes come below those of all together.
    """
    limits: dict[tuple[str, str], tuple[Cell, Cell]] = {
        (verdict.measure, verdict.of): (verdict.limit, verdict.passed)
        for verdict in report.verdicts
        if verdict.line.endswith("p99")
    }
    of_processes = [
        msgspec.structs.replace(row, of=f"{process.agent}: {row.of}".rstrip(": "))
        for process in report.processes
        for row in process.times
    ]
    by_measure: dict[str, list[Times]] = {}
    for row in (*report.times, *of_processes):
        by_measure.setdefault(row.measure, []).append(row)
    tables = []
    for measure, found in by_measure.items():
        rows: list[tuple[Cell, ...]] = []
        for row in found:
            name = f"{row.of} (from outside)" if row.outside else row.of
            rows.append((name, *_figures(row.times), *limits.get((measure, row.of), ("", ""))))
        columns = _JUDGED if any(row[-1] != "" for row in rows) else _TIMES
        notes = [MEANINGS[measure], *([_ACROSS] if any(ACROSS in row.of for row in found) else [])]
        cut = [row[: len(columns)] for row in rows]
        tables.append(Table(f"{measure.capitalize()} [ms]", columns, cut, notes))
    return tables


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
        "± is half their round trip, the largest error if one way is slower than the other",
    )
    return [Table("Clocks", columns, rows, notes)] if rows else []


def processes_tables(processes: Sequence[ProcessTiming]) -> list[Table]:
    """Return the counts of each process, if they have rows of their own."""
    if not any(process.times for process in processes):
        return []
    columns = (
        key_column("process"),
        word_column("tier"),
        Column("slowest decision", "ms"),
        Column("CPU", "%", 1),
        Column("memory", "MB", 1),
        *map(Column, ("missed deadlines", "overruns", "skipped cycles", "dropped")),
    )
    rows = [
        (
            one.agent,
            one.tier,
            None if one.slowest_decision_us is None else one.slowest_decision_us / 1e3,
            one.cpu_percent,
            one.resident_mb,
            count_of(one.missed_deadlines),
            count_of(one.overruns),
            one.skipped_cycles,
            count_of(one.dropped),
        )
        for one in processes
    ]
    return [Table("Processes", columns, rows)]


def budgets_table(verdicts: Iterable[Verdict]) -> Table:
    """Return the budgets that no row of the durations shows."""
    columns = (key_column("budget"), Column("measured"), Column("at most"), word_column(""))
    rows = tuple(
        (one.line, _amount(one.value, one.unit), _amount(one.limit, one.unit), one.passed)
        for one in verdicts
        if not one.measure or one.value is None or not one.line.endswith("p99")
    )
    return Table("Other budgets", columns, rows)
