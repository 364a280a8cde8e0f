"""The timing of a run as tables in a terminal, at most 100 columns wide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Final, TypeAlias

from rich.console import Console
from rich.markup import escape

from launch_scripts.timing.budgets import Verdict
from launch_scripts.timing.distributions import Distribution
from launch_scripts.timing.figure_tables import Column, print_table
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.host import Host
from launch_scripts.timing.measures import TierAccount, Times
from launch_scripts.timing.rates import cycles_per_s
from launch_scripts.timing.tier_columns import TIER_COLUMNS
from launch_scripts.timing.timing_report import ProcessTimes, TimingReport
from launch_scripts.wrong_messages import one_line_each

MEANINGS: Final = {
    "loop": "plant's scheduled tick to the applied command",
    "decision": "stage could close, to its last message handed to the bus",
    "hop": "published to arrived",
    "lateness": "after the scheduled time, of what the clock drives",
    "jitter": "difference of the time between two closings from the cycle",
    "age": "of the oldest input, at the decision",
    "response": "last input published, to own message published",
    "floor": "this machine, beside the plant, at the same rate",
}
"""What each measure is of, in a few words; docs/timing.md has the definitions."""

_TIMES: Final = (
    Column("count", 8),
    *(Column(name, 9) for name in ("min", "p50", "p99", "p99.9", "max")),
    Column("p99\nat most", 9),
    Column("", 4),
)

_MOST_US: Final = 10e6
"""What is longer needs milliseconds."""

_HOPS: Final = "(from the publishing of what each waited for: the hop to it is part of its time)"

_PASSED: Final = {True: "PASS", False: "[bold red]FAIL[/]"}

_DECIMALS: Final = {"ms": 3, "%": 2, "MB": 1, "": 0}
"""How many a budget's figure has, by its unit."""

_Format: TypeAlias = Callable[[float], str]


def print_report(report: TimingReport, console: Console, *, processes: bool) -> None:
    """Print the tables of a run.

    Parameters
    ----------
    report
        Of the run.
    console
        Where to.
    processes
        Whether each process has a table of its own as well.
    """
    for line in header_lines(report):
        console.print(line, highlight=False, markup=False)
    show, unit = _format(report)
    _print_times(report, show, unit, console)
    _print_tiers(report.tiers, console)
    for process in report.processes if processes else ():
        _print_process(process, show, unit, console)
    console.print()
    for line in (*cycle_lines(report), *network_lines(report)):
        console.print(line, highlight=False, markup=False)
    _print_other_verdicts(report.verdicts, console)
    failed = [verdict for verdict in report.verdicts if not verdict.passed]
    console.print(verdict_line(report), highlight=False, markup=False)
    for verdict in failed:
        console.print(f"  not kept: {failure(verdict)}", highlight=False, markup=False)


def header_lines(report: TimingReport) -> list[str]:
    """Return what was run, and on what."""
    return [
        f"{report.scenario} at {cycles_per_s(report.rate_hz)} in real time: {report.cycles:,} cycle"
        f"{'' if report.cycles == 1 else 's'} in {report.wall_s:.1f} s"
        f"{', interrupted' if report.interrupted else ''}",
        *host_lines(report.host),
        *_busy(report),
        *report.remarks,
    ]


def host_lines(host: Host) -> list[str]:
    """Return on what it was run."""
    locked = "; memory locked" if host.memory_locked else ""
    return [
        f"kernel {host.kernel}",
        f"{host.cpus} CPUs, {host.cpu}; load average {host.load_before:.2f} before, "
        f"{host.load_after:.2f} after",
        f"scheduling: {'; '.join(host.policies) or 'not known'}{locked}",
        f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}",
    ]


def _busy(report: TimingReport) -> list[str]:
    host = report.host
    if host.load_before <= host.cpus:
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
    return [
        *external,
        *wrong,
        *([f"faults of the network, as was asked for: {faults}"] if faults else []),
    ]


def cycle_lines(report: TimingReport) -> list[str]:
    """Say what made the slowest cycles slow."""
    told = [
        f"{'slowest' if place == 0 else 'next'} {cycle.text}"
        for place, cycle in enumerate(report.slowest_cycles)
    ]
    return [*told, *([_HOPS] if told else [])]


def verdict_line(report: TimingReport) -> str:
    """Return the verdict on the whole run."""
    failed = sum(not verdict.passed for verdict in report.verdicts)
    if not failed:
        return f"PASS: all {len(report.verdicts)} budgets were kept"
    were = "was" if failed == 1 else "were"
    return f"FAIL: {failed} of {len(report.verdicts)} budgets {were} not kept"


def failure(verdict: Verdict) -> str:
    """Return a budget that was not kept, with what was measured."""
    if verdict.value is None:
        return f"{verdict.line}: nothing was measured"
    value, limit = (amount(figure, verdict.unit) for figure in (verdict.value, verdict.limit))
    return f"{verdict.line} {value} (at most {limit})"


def amount(value: float, unit: str) -> str:
    """Write a figure of a budget: `12.345 ms`, `0.76 %`."""
    return f"{value:,.{_DECIMALS[unit]}f} {unit}".rstrip()


def how_often(count: int) -> str:
    """Say how often: `1 time`, `2 times`."""
    return f"{count:,} time{'' if count == 1 else 's'}"


def row_name(row: Times) -> str:
    """Return the name of a row of durations."""
    return f"{row.of} (seen from outside)" if row.outside else row.of


def percentiles(times: Distribution) -> tuple[float, ...]:
    """Return the figures of a distribution in the order of the columns [us]."""
    return times.min_us, times.p50_us, times.p99_us, times.p99_9_us, times.max_us


def _format(report: TimingReport) -> tuple[_Format, str]:
    """Choose one unit for all columns of durations, and how they are written."""
    longest_us = max((row.times.max_us for row in report.times), default=0.0)
    if longest_us < _MOST_US:
        return lambda value_us: f"{value_us:,.0f}", "µs"
    return lambda value_us: f"{value_us / 1e3:,.1f}", "ms"


def _print_times(report: TimingReport, show: _Format, unit: str, console: Console) -> None:
    """Print a table for each measure, and one for the floor."""
    verdicts = {(entry.measure, entry.of): entry for entry in reversed(report.verdicts)}
    for measure, found in groupby(report.times, lambda row: row.measure):
        rows = list(found)
        outside = " (seen from outside)" if all(row.outside for row in rows) else ""
        heading = f"[bold]{measure}[/] \\[{unit}]: {MEANINGS[measure]}{outside}"
        cells = [
            (
                f"  {escape(row.of)}",
                f"{row.times.count:,}",
                *map(show, percentiles(row.times)),
                *_verdict_cells(verdicts.get((row.measure, row.of)), show),
            )
            for row in rows
        ]
        print_table(console, heading, _TIMES, cells)
    print_floor(f"[bold]floor[/] \\[{unit}]: {MEANINGS['floor']}", report.floor, show, console)


def print_floor(title: str, floor: Sequence[FloorTimes], show: _Format, console: Console) -> None:
    """Print what the machine itself needs, and why some of it was not measured."""
    cells = [
        (f"  {row.name}", f"{row.times.count:,}", *map(show, percentiles(row.times)))
        for row in floor
        if row.times is not None
    ]
    print_table(console, title, _TIMES[:6], cells)
    for row in floor:
        if row.note:
            console.print(f"  {row.name}: {row.note}", highlight=False, markup=False)


def _verdict_cells(verdict: Verdict | None, show: _Format) -> tuple[str, str]:
    if verdict is None:
        return "", ""
    return show(verdict.limit * 1e3), _PASSED[verdict.passed]


def _print_tiers(tiers: Iterable[TierAccount], console: Console) -> None:
    heading = "[bold]counts[/], processor time \\[% of a core] and memory (of the largest process)"
    columns = [Column(escape(column.heading), column.width) for column in TIER_COLUMNS]
    rows = [(f"  {tier.tier}", *(column.text(tier) for column in TIER_COLUMNS)) for tier in tiers]
    print_table(console, heading, columns, rows)


def _print_process(process: ProcessTimes, show: _Format, unit: str, console: Console) -> None:
    title = (
        f"{process.agent} ({process.tier}), times in {unit}: CPU {process.cpu_percent:.1f} %, "
        f"{process.resident_mb:.1f} MB, {how_often(process.switches_involuntary)} preempted; "
        f"{_counts(process)}"
    )
    rows = [
        (
            escape(f"  {row.measure} {row.of}".rstrip()),
            f"{row.times.count:,}",
            *map(show, percentiles(row.times)),
        )
        for row in process.times
    ]
    print_table(console, escape(title), _TIMES[:6], rows)


def _counts(process: ProcessTimes) -> str:
    counts: Sequence[tuple[str, Mapping[str, int]]] = (
        ("missed", process.missed_deadlines),
        ("overruns", process.overruns),
        ("missing", process.missing_inputs),
        ("dropped", process.dropped),
    )
    told = [
        f"{name} {', '.join(f'{key} {count:,}' for key, count in found.items())}"
        for name, found in counts
        if found
    ]
    if process.cycles_given_up:
        told.append(f"{process.cycles_given_up:,} cycles given up")
    return "; ".join(told) or "kept every deadline"


def _print_other_verdicts(verdicts: Iterable[Verdict], console: Console) -> None:
    """Print the budgets that no row of the durations shows."""
    columns = (Column("measured", 12), Column("at most", 12), Column("", 4))
    rows = [
        (
            f"  {escape(verdict.line)}",
            "nothing" if verdict.value is None else amount(verdict.value, verdict.unit),
            amount(verdict.limit, verdict.unit),
            _PASSED[verdict.passed],
        )
        for verdict in verdicts
        if not verdict.measure or verdict.value is None or not verdict.line.endswith("p99")
    ]
    print_table(console, "[bold]other budgets[/]", columns, rows)
