"""Runs at several rates, one after another: how fast a plant can go on this machine."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Final, TypeAlias

import msgspec
from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.launcher.supervision import RunFailure
from studies.tables import Cell, Column, Table, key_column, print_table, word_column
from studies.timing.host import Host
from studies.timing.processes import total
from studies.timing.rates import LOWEST_HZ, Rates, cycles_per_s
from studies.timing.report import TimingReport
from studies.timing.run_timing import LOOP, WHOLE_LOOP
from studies.timing.tables import host_lines, how_often, print_lines

_CLOSE_ENOUGH: Final = 1.1
"""The search ends where the lowest rate that fails is no further above the highest clean one."""


class RateRow(msgspec.Struct, frozen=True):
    """The run at one rate.

    Attributes
    ----------
    loop_p50_us, loop_p99_us, loop_max_us
        Loop time [us]; None if the plant ended no cycle.
    missed_deadlines, overruns, lost_messages
        Of all processes together.
    cpu_percent
        Processor time of all processes together [% of one core].
    clean
        Whether nothing was missed, overran, was skipped or lost.
    trouble
        What was, and in which tier.
    failed
        Why the run failed; empty if it did not.
    interrupted
        Whether the user ended it early: then it proves nothing.
    """

    rate_hz: float
    cycles: int = 0
    loop_p50_us: float | None = None
    loop_p99_us: float | None = None
    loop_max_us: float | None = None
    missed_deadlines: int = 0
    overruns: int = 0
    lost_messages: int = 0
    cpu_percent: float | None = None
    clean: bool = False
    failed: str = ""
    interrupted: bool = False
    trouble: str = ""
    host: Host | None = None

    @property
    def outcome(self) -> str:
        """Its outcome in a word or two."""
        if self.interrupted:
            return "interrupted"
        if self.failed:
            return "failed"
        return "clean" if self.clean else "not clean"

    @property
    def too_fast(self) -> bool:
        """Whether it shows that the plant does not keep up at this rate."""
        return not (self.clean or self.interrupted)


class Sweep(msgspec.Struct, frozen=True):
    """Runs at several rates, ascending; `highest_clean_hz` is None if none was clean."""

    rows: tuple[RateRow, ...]
    highest_clean_hz: float | None
    interrupted: bool


Timed: TypeAlias = Callable[[float], TimingReport]
"""Runs the plant at a rate and reports on it."""


def sweep(rates: Rates, timed: Timed) -> Sweep:
    """Run at the listed rates; or search for the highest clean one, doubling, then halving steps.

    A rate of a search may be refused because stated deadlines do not fit into its cycle, or its
    run may fail: that rate has failed, and the others still count.

    Raises
    ------
    InputError
        The very first rate is refused.
    """
    rows: dict[float, RateRow] = {}
    for rate_hz in _search(rates.search_hz, rows) if rates.search_hz else rates.listed_hz:
        try:
            rows[rate_hz] = rate_row(timed(rate_hz))
        except KeyboardInterrupt:
            rows[rate_hz] = RateRow(rate_hz, interrupted=True)
        except InputError as error:
            if not rows:
                raise
            rows[rate_hz] = RateRow(rate_hz, failed=str(error))
        except RunFailure as failure:
            rows[rate_hz] = RateRow(rate_hz, failed=str(failure).splitlines()[0])
        if rows[rate_hz].interrupted:
            break
    clean = [rate_hz for rate_hz, row in rows.items() if row.clean]
    in_order = tuple(rows[rate_hz] for rate_hz in sorted(rows))
    return Sweep(in_order, max(clean, default=None), any(row.interrupted for row in in_order))


def rate_row(report: TimingReport) -> RateRow:
    """Return the row of a run."""
    rows = {(row.measure, row.of): row.times for row in report.times}
    loop = rows.get((LOOP, WHOLE_LOOP))
    return RateRow(
        rate_hz=report.rate_hz,
        cycles=report.cycles,
        loop_p50_us=loop.p50_us if loop else None,
        loop_p99_us=loop.p99_us if loop else None,
        loop_max_us=loop.max_us if loop else None,
        missed_deadlines=sum(tier.missed_deadlines for tier in report.tiers),
        overruns=sum(tier.overruns for tier in report.tiers),
        lost_messages=report.lost_messages or 0,
        cpu_percent=total(tier.cpu_percent for tier in report.tiers),
        clean=report.clean and not report.interrupted,
        interrupted=report.interrupted,
        trouble=_trouble(report),
        host=report.host,
    )


def _trouble(report: TimingReport) -> str:
    """Say what keeps a run from being clean, tier by tier."""
    found = [] if report.cycles else ["no cycle was completed"]
    for tier in report.tiers:
        counts = (
            ("missed a deadline", tier.missed_deadlines),
            ("overran", tier.overruns),
            ("skipped a cycle", tier.skipped_cycles),
        )
        found += [f"{tier.tier} {what} {how_often(count)}" for what, count in counts if count]
    if report.lost_messages:
        found.append(f"messages not recorded: {report.lost_messages:,}")
    return ", ".join(found)


def print_sweep(found: Sweep, console: Console) -> None:
    """Print the rates, on what they were run, and the highest clean one."""
    print_lines(console, [*machine_lines(found), ""])
    print_table(console, sweep_table(found))
    print_lines(console, [*trouble_lines(found), conclusion(found)])


def sweep_table(found: Sweep) -> Table:
    """Return a row for each rate."""
    columns = (
        key_column("rate"),
        Column("cycles"),
        Column("cycle", "ms", 2),
        Column("loop p50", "ms"),
        Column("loop p99", "ms"),
        Column("loop max", "ms"),
        *map(Column, ("missed deadlines", "overruns", "lost")),
        Column("CPU", "%", 0),
        word_column(""),
    )
    return Table("Rates [cycles/s]", columns, tuple(map(_cells, found.rows)))


def machine_lines(found: Sweep) -> list[str]:
    """Say on which machine, with the load before the first rate and after the last one."""
    hosts = [row.host for row in found.rows if row.host is not None]
    if not hosts:
        return []
    return host_lines(msgspec.structs.replace(hosts[-1], load_before=hosts[0].load_before))


def trouble_lines(found: Sweep) -> list[str]:
    """Say of each rate that failed or was not clean what went wrong."""
    return [
        f"{cycles_per_s(row.rate_hz)} failed: {row.failed}"
        if row.failed
        else f"{cycles_per_s(row.rate_hz)} was not clean: {row.trouble}"
        for row in found.rows
        if row.failed or (row.trouble and not row.interrupted)
    ]


def _search(search_hz: tuple[float, float], rows: dict[float, RateRow]) -> Iterator[float]:
    """Yield rates to try; each is run, and has its row, before the next one is asked for."""
    rate_hz, highest_hz = search_hz
    yield rate_hz
    while rows[rate_hz].clean and rate_hz < highest_hz:
        rate_hz = min(2.0 * rate_hz, highest_hz)
        yield rate_hz
    while bounds := _bounds(rows.values()):
        clean_hz, failed_hz = bounds
        if failed_hz <= clean_hz * _CLOSE_ENOUGH:
            return
        rate_hz = float(f"{(clean_hz * failed_hz) ** 0.5:.3g}")
        if rate_hz in rows:
            return  # It proved nothing, and would not the next time.
        yield rate_hz


def _bounds(rows: Collection[RateRow]) -> tuple[float, float] | None:
    """Return the highest clean rate and the lowest too fast one above; None if either lacks."""
    clean_hz = max((row.rate_hz for row in rows if row.clean), default=None)
    if clean_hz is None:
        return None
    failed = [row.rate_hz for row in rows if row.too_fast and row.rate_hz > clean_hz]
    return (clean_hz, min(failed)) if failed else None


def _cells(row: RateRow) -> tuple[Cell, ...]:
    loop_us = (row.loop_p50_us, row.loop_p99_us, row.loop_max_us)
    return (
        f"{row.rate_hz:.4g}",
        row.cycles,
        1e3 / row.rate_hz,
        *(None if value_us is None else value_us / 1e3 for value_us in loop_us),
        *(row.missed_deadlines, row.overruns, row.lost_messages, row.cpu_percent),
        row.outcome,
    )


def conclusion(found: Sweep) -> str:
    """Say how fast the plant can go."""
    if found.highest_clean_hz is None:
        return _none_was_clean(found)
    known = any(row.rate_hz > found.highest_clean_hz and row.too_fast for row in found.rows)
    at_least = "" if known else "at least "
    return (
        f"highest clean rate: {at_least}{cycles_per_s(found.highest_clean_hz)} (no deadline "
        "missed, no stage overrun, no cycle skipped, no message lost)"
    )


def _none_was_clean(found: Sweep) -> str:
    if found.interrupted:
        return "interrupted before a rate was found to be clean"
    tried_hz = [row.rate_hz for row in found.rows]
    lowest_hz = min(tried_hz)
    what = f"no rate was clean: {len(tried_hz)} tried, from {cycles_per_s(lowest_hz)} on"
    if lowest_hz <= LOWEST_HZ or all(row.failed for row in found.rows):
        return what
    below = f"{max(lowest_hz / 10.0, LOWEST_HZ):.3g}..{lowest_hz:.4g}"
    return f"{what}; slower ones are tried by --rate {below}"
