"""The timing of a run as tables in a terminal, 100 columns wide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Final, TypeAlias

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from launch_scripts.timing.budgets import Verdict
from launch_scripts.timing.distributions import Distribution
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.measures import TierAccount, Times
from launch_scripts.timing.tier_columns import TIER_COLUMNS
from launch_scripts.timing.timing_report import ProcessTimes, TimingReport

WIDTH: Final = 100

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
    ("count", 8),
    *((name, 9) for name in ("min", "p50", "p99", "p99.9", "max")),
    ("p99\nat most", 9),
    ("", 4),
)

_MOST_US: Final = 10e6
"""What is longer needs milliseconds."""

_HOPS: Final = "(from the publishing of what each waited for: the hop to it is part of its time)"

_PASSED: Final = {True: "PASS", False: "[bold red]FAIL[/]"}

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
    for table in _times_tables(report, show, unit):
        console.print(table)
    for line in _floor_notes(report.floor):
        console.print(line, highlight=False, markup=False)
    console.print(_tier_table(report.tiers))
    for process in report.processes if processes else ():
        console.print(_process_table(process, show, unit))
    console.print()
    for line in (*cycle_lines(report), *network_lines(report)):
        console.print(line, highlight=False, markup=False)
    console.print(_other_verdicts(report.verdicts))
    failed = [verdict for verdict in report.verdicts if not verdict.passed]
    console.print(verdict_line(report), highlight=False, markup=False)
    for verdict in failed:
        console.print(f"  not kept: {failure(verdict)}", highlight=False, markup=False)


def header_lines(report: TimingReport) -> list[str]:
    """Return what was run, and on what."""
    host = report.host
    return [
        f"{report.scenario} at {report.rate_hz:g} cycles/s in real time: {report.cycles:,} cycles "
        f"in {report.wall_s:.1f} s{', interrupted' if report.interrupted else ''}",
        f"kernel {host.kernel}",
        f"{host.cpus} CPUs, {host.cpu}; load average {host.load_before:.2f} before, "
        f"{host.load_after:.2f} after",
        f"scheduling: {'; '.join(host.policies) or 'not known'}",
        f"Python {host.python}, heliarch {host.heliarch}, Zenoh {host.zenoh}",
        *_busy(report),
        *report.remarks,
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
        f"external {account.agent}: answered {account.answered:,} times of {account.expected:,}, "
        f"{account.lost:,} of its messages never came, which gaps in their numbers tell"
        for account in report.external
    ]
    wrong = [
        f"wrong {entry.key}, {entry.count:,} times: {entry.cause}: {entry.example}"
        for entry in report.wrong
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
    unit = f" {verdict.unit}" if verdict.unit else ""
    return f"{verdict.line} {verdict.value:,.4g}{unit} (at most {verdict.limit:,.4g}{unit})"


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


def _new_table(title: str, columns: Sequence[tuple[str, int]], *, header: bool = True) -> Table:
    """Return an empty table: a name, then columns of fixed widths, so that tables line up."""
    table = Table(
        title=title,
        title_justify="left",
        title_style="",
        box=None,
        width=WIDTH,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        show_header=header,
        header_style="",
    )
    table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    for column, width in columns:
        table.add_column(column, justify="right", no_wrap=True, width=width)
    return table


def _times_tables(report: TimingReport, show: _Format, unit: str) -> Iterator[Table]:
    """Yield a table for each measure, and one for the floor."""
    verdicts = {(entry.measure, entry.of): entry for entry in reversed(report.verdicts)}
    for place, (measure, found) in enumerate(groupby(report.times, lambda row: row.measure)):
        rows = list(found)
        outside = " (seen from outside)" if all(row.outside for row in rows) else ""
        heading = f"\n[bold]{measure}[/] \\[{unit}]: {MEANINGS[measure]}{outside}"
        table = _new_table(heading, _TIMES, header=place == 0)
        for row in rows:
            table.add_row(
                f"  {row.of}",
                f"{row.times.count:,}",
                *map(show, percentiles(row.times)),
                *_verdict_cells(verdicts.get((row.measure, row.of)), show),
            )
        yield table
    heading = f"\n[bold]floor[/] \\[{unit}]: {MEANINGS['floor']}"
    table = _new_table(heading, _TIMES, header=False)
    for floor in report.floor:
        if floor.times is not None:
            figures = map(show, percentiles(floor.times))
            table.add_row(f"  {floor.name}", f"{floor.times.count:,}", *figures, "", "")
    yield table


def _verdict_cells(verdict: Verdict | None, show: _Format) -> tuple[str, str]:
    if verdict is None:
        return "", ""
    return show(verdict.limit * 1e3), _PASSED[verdict.passed]


def _floor_notes(floor: Iterable[FloorTimes]) -> Iterator[str]:
    for row in floor:
        if row.note:
            yield f"  {row.name}: {row.note}"


def _tier_table(tiers: Iterable[TierAccount]) -> Table:
    heading = (
        "\n[bold]counts[/], processor time \\[% of a core] and memory (of the largest process)"
    )
    columns = [(escape(column.heading), column.width) for column in TIER_COLUMNS]
    table = _new_table(heading, columns)
    for tier in tiers:
        table.add_row(f"  {tier.tier}", *(column.text(tier) for column in TIER_COLUMNS))
    return table


def _process_table(process: ProcessTimes, show: _Format, unit: str) -> Table:
    title = (
        f"\n{process.agent} ({process.tier}), times in {unit}: CPU {process.cpu_percent:.1f} %, "
        f"{process.resident_mb:.1f} MB, {process.switches_involuntary:,} times preempted; "
        f"{_counts(process)}"
    )
    table = _new_table(escape(title), _TIMES[:6])
    for row in process.times:
        name = f"  {row.measure} {row.of}".rstrip()
        table.add_row(name, f"{row.times.count:,}", *map(show, percentiles(row.times)))
    return table


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


def _other_verdicts(verdicts: Iterable[Verdict]) -> Table:
    """Return the budgets that no row of the durations shows."""
    table = _new_table("\n[bold]other budgets[/]", (("measured", 12), ("at most", 12), ("", 4)))
    for verdict in verdicts:
        if verdict.measure and verdict.value is not None and verdict.line.endswith("p99"):
            continue
        unit = f" {verdict.unit}" if verdict.unit else ""
        value = "nothing" if verdict.value is None else f"{verdict.value:,.4g}{unit}"
        limit = f"{verdict.limit:,.4g}{unit}"
        table.add_row(f"  {verdict.line}", value, limit, _PASSED[verdict.passed])
    return table
