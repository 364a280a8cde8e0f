"""The timing of a run as tables in a terminal, at most 100 columns wide. Durations are in ms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Final

from rich.console import Console

from launch_scripts.launcher.wrong_messages import one_line_each
from studies.timing.budgets import Verdict
from studies.timing.durations import Distribution
from studies.timing.figure_tables import Column, FigureTable, print_table
from studies.timing.floor import FloorTimes
from studies.timing.host import Host
from studies.timing.rates import cycles_per_s
from studies.timing.report import ProcessTimes, TimingReport
from studies.timing.run_timing import Times
from studies.timing.tiers import MISSING, TIER_COLUMNS, TierAccount, figure

MEANINGS: Final = {
    "loop": "plant's scheduled tick to its last command; each command: to its publishing",
    "decision": "stage could close, to its last message published",
    "hop": "input that completed a stage published, to stage could close",
    "lateness": "scheduled time of what the clock closes, to its first message published",
    "jitter": "difference of the time between two first messages from the cycles between",
    "age": "oldest input published, to stage could close",
    "response": "last input published, to own last message published",
    "floor": "this machine, beside the plant, at the same rate",
}
"""What each measure is of, in a few words; docs/timing.md has the definitions."""

_TIMES: Final = (
    Column("count", 8),
    *(Column(name, 9) for name in ("min", "p50", "p99", "p99.9", "max")),
    Column("p99\nat most", 9),
    Column("", 4),
)

_HOPS: Final = "(from the publishing of what each waited for: the hop to it is part of its time)"
_PASSED: Final = {True: "PASS", False: "FAIL"}
_DECIMALS: Final = {"ms": 3, "%": 2, "MB": 1, "": 0}
"""How many a budget's figure has, by its unit."""


def print_report(report: TimingReport, console: Console, *, processes: bool) -> None:
    """Print the tables of a run; with `processes` one for each process as well."""
    for line in header_lines(report):
        console.print(line, highlight=False, markup=False)
    for table in (*times_tables(report), counts_table(report.tiers)):
        print_table(console, table)
    for process in report.processes if processes else ():
        print_table(console, _process_table(process))
    console.print()
    for line in (*cycle_lines(report), *network_lines(report)):
        console.print(line, highlight=False, markup=False)
    print_table(console, budgets_table(report.verdicts))
    console.print(verdict_line(report), highlight=False, markup=False)
    for line in failures(report):
        console.print(f"  not kept: {line}", highlight=False, markup=False)


def header_lines(report: TimingReport) -> list[str]:
    """Return what was run, and on what."""
    return [
        f"{report.scenario} at {cycles_per_s(report.rate_hz)} in real time: {report.cycles:,} cycle"
        f"{'' if report.cycles == 1 else 's'} in {report.wall_s:.1f} s"
        f"{', interrupted' if report.interrupted else ''}",
        *host_lines(report.host),
        *_busy(report.host),
        *report.remarks,
    ]


def host_lines(host: Host) -> list[str]:
    """Return on what it was run."""
    locked = "; memory locked" if host.memory_locked else ""
    before, after = figure(host.load_before, 2), figure(host.load_after, 2)
    return [
        f"kernel {host.kernel}",
        f"{host.cpus} CPUs{', ' * bool(host.cpu)}{host.cpu}; load average {before} before, "
        f"{after} after",
        f"scheduling: {host.scheduling}{locked}",
        f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}",
    ]


def _busy(host: Host) -> list[str]:
    if host.load_before is None or host.load_before <= host.cpus:
        return []
    return [
        "the machine was busy before the run began, with more than its processors can do: see the "
        "floor for what that costs"
    ]


def network_lines(report: TimingReport) -> list[str]:
    """Say what external agents sent, what of it was wrong, and what faults did to messages."""
    external = [
        f"external {account.agent}: answered {how_often(account.answered)} of {account.expected:,}"
        f", {account.lost:,} of its messages never came or could not be decoded, which gaps in "
        "their numbers tell"
        for account in report.external
    ]
    wrong = [
        f"wrong {entry.key}, {how_often(entry.count)}: {entry.cause}: {entry.example}"
        for entry in one_line_each(report.wrong)
    ]
    faults = ", ".join(f"{count:,} {name}" for name, count in report.faults.items())
    asked_for = [f"faults of the network, as was asked for: {faults}"] if faults else []
    return [*external, *wrong, *asked_for]


def cycle_lines(report: TimingReport) -> list[str]:
    """Say what made the slowest cycles slow."""
    told = [
        f"{'slowest' if place == 0 else 'next'} {cycle.text}"
        for place, cycle in enumerate(report.slowest_cycles)
    ]
    return [*told, *([_HOPS] if told else [])]


def verdict_line(report: TimingReport) -> str:
    """Return the verdict on the whole run."""
    failed = len(failures(report))
    if not failed:
        return f"PASS: all {len(report.verdicts)} budgets were kept"
    return f"FAIL: {failed} of {len(report.verdicts)} budgets not kept"


def failures(report: TimingReport) -> list[str]:
    """Return the budgets that were not kept, with what was measured."""
    return [
        f"{verdict.line}: nothing was measured"
        if verdict.value is None
        else f"{verdict.line} {amount(verdict.value, verdict.unit)} "
        f"(at most {amount(verdict.limit, verdict.unit)})"
        for verdict in report.verdicts
        if not verdict.passed
    ]


def amount(value: float, unit: str) -> str:
    """Write a figure of a budget: `12.345 ms`, `0.76 %`."""
    return f"{value:,.{_DECIMALS[unit]}f} {unit}".rstrip()


def how_often(count: int) -> str:
    """Say how often: `1 time`, `2 times`."""
    return f"{count:,} time{'' if count == 1 else 's'}"


def ms(value_us: float | None) -> str:
    """Write a duration in ms."""
    return MISSING if value_us is None else f"{value_us / 1e3:,.3f}"


def row_name(row: Times) -> str:
    """Return the name of a row of durations, where it stands beside others."""
    return f"{row.of} (seen from outside)" if row.outside else row.of


def times_cells(times: Distribution) -> tuple[str, ...]:
    """Return the figures of a distribution in the order of the columns."""
    values_us = (times.min_us, times.p50_us, times.p99_us, times.p99_9_us, times.max_us)
    return (f"{times.count:,}", *map(ms, values_us))


def times_tables(report: TimingReport) -> list[FigureTable]:
    """Return a table for each measure, and one for the floor."""
    tables = []
    for measure, found in groupby(report.times, lambda row: row.measure):
        rows = list(found)
        outside = " (seen from outside)" if all(row.outside for row in rows) else ""
        cells = [(row.of, *times_cells(row.times), *_limit(row, report.verdicts)) for row in rows]
        meaning = f" [ms]: {MEANINGS[measure]}{outside}"
        tables.append(FigureTable(measure, meaning, _TIMES, cells))
    if report.floor:
        tables.append(floor_table("floor", f" [ms]: {MEANINGS['floor']}", report.floor))
    return tables


def _limit(row: Times, verdicts: Iterable[Verdict]) -> tuple[str, str]:
    """Return the limit of a row of durations and whether it was kept, empty if it has none."""
    for verdict in verdicts:
        if (verdict.measure, verdict.of) == (row.measure, row.of):
            return f"{verdict.limit:,.3f}", _PASSED[verdict.passed]
    return "", ""


def floor_table(title: str, meaning: str, floor: Iterable[FloorTimes]) -> FigureTable:
    """Return what the machine itself needs, or why it was not measured."""
    rows = [
        (
            f"{row.name}: {row.note}" if row.note else row.name,
            *(("",) * 6 if row.times is None else times_cells(row.times)),
        )
        for row in floor
    ]
    return FigureTable(title, meaning, _TIMES[:6], rows)


def counts_table(tiers: Iterable[TierAccount]) -> FigureTable:
    """Return what the processes of each tier counted and took."""
    columns = [Column(column.heading, column.width) for column in TIER_COLUMNS]
    rows = [(tier.tier, *(column.text(tier) for column in TIER_COLUMNS)) for tier in tiers]
    meaning = ", processor time [% of a core] and memory (of the largest process)"
    return FigureTable("counts", meaning, columns, rows)


def budgets_table(verdicts: Iterable[Verdict]) -> FigureTable:
    """Return the budgets that no row of the durations shows."""
    columns = (Column("measured", 12), Column("at most", 12), Column("", 4))
    rows = [
        (
            verdict.line,
            "nothing" if verdict.value is None else amount(verdict.value, verdict.unit),
            amount(verdict.limit, verdict.unit),
            _PASSED[verdict.passed],
        )
        for verdict in verdicts
        if not verdict.measure or verdict.value is None or not verdict.line.endswith("p99")
    ]
    return FigureTable("other budgets", "", columns, rows)


def _process_table(process: ProcessTimes) -> FigureTable:
    meaning = (
        f" ({process.tier}), times in ms: CPU {figure(process.cpu_percent, 1)} %, "
        f"{figure(process.resident_mb, 1)} MB; {_counts(process)}"
    )
    rows = [(f"{row.measure} {row.of}".rstrip(), *times_cells(row.times)) for row in process.times]
    return FigureTable(process.agent, meaning, _TIMES[:6], rows)


def _counts(process: ProcessTimes) -> str:
    counts: Sequence[tuple[str, Mapping[str, int]]] = (
        ("missed", process.missed_deadlines),
        ("overruns", process.overruns),
        ("missing", process.missing_inputs),
        ("dropped", process.dropped or {}),
    )
    told = [
        f"{name} {', '.join(f'{key} {count:,}' for key, count in found.items())}"
        for name, found in counts
        if found
    ]
    if process.skipped_cycles:
        told.append(f"{process.skipped_cycles:,} cycles skipped")
    return "; ".join(told) or "kept every deadline"
