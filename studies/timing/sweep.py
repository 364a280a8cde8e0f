"""Runs at several rates, one after another: how fast a plant can go on this machine."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Final, TypeAlias

import msgspec
from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.launcher.supervision import RunFailure
from studies.timing.figure_tables import Column, FigureTable, print_table
from studies.timing.floor import FloorTimes
from studies.timing.host import Host
from studies.timing.rates import LOWEST_HZ, Rates, cycles_per_s
from studies.timing.report import TimingReport
from studies.timing.run_timing import LOOP, WHOLE_LOOP
from studies.timing.table import floor_table, host_lines, how_often, ms
from studies.timing.tiers import figure, total

_CLOSE_ENOUGH: Final = 1.1
"""The search ends where the lowest rate that fails is no further above the highest clean one."""


class RateRow(msgspec.Struct, frozen=True):
    """What a plant came to at one rate.

    Attributes
    ----------
    rate_hz, cycles
        Cycles a second, and how many there were.
    loop_p50_us, loop_p99_us, loop_max_us
        Loop time [us]; None where no loop closed.
    missed_deadlines, overruns, lost_messages
        Of all processes together.
    cpu_percent
        Processor time of all processes together, the recorder too [% of one core].
    clean
        Whether none was missed, none overran and nothing was skipped or lost.
    trouble
        What was missed, overran or was lost, and in which tier; empty if nothing was.
    failed
        Why the run failed; empty if it did not.
    interrupted
        Whether the user ended it early: then it proves nothing.
    host, floor
        What it was run on, and what that machine needs by itself at this rate.
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
    floor: tuple[FloorTimes, ...] = ()

    @property
    def outcome(self) -> str:
        """What became of it, in a word or two."""
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
    """Runs at several rates.

    Attributes
    ----------
    rows
        By rate, ascending.
    highest_clean_hz
        The highest rate at which the plant kept up; None: it never did.
    interrupted
        Whether the user ended it early.
    """

    rows: tuple[RateRow, ...]
    highest_clean_hz: float | None
    interrupted: bool

    def as_json(self) -> bytes:
        """Return the sweep as JSON."""
        return msgspec.json.format(msgspec.json.encode(self), indent=1)


Timed: TypeAlias = Callable[[float], TimingReport]
"""Runs the plant at a rate and reports on it."""

_MEANING: Final = " [cycles/s]: cycle and loop time [ms], processor time [% of a core]"
_COLUMNS: Final = (
    Column("cycles", 8),
    Column("cycle", 8),
    Column("loop\np50", 8),
    Column("loop\np99", 8),
    Column("loop\nmax", 8),
    Column("missed\ndeadlines", 9),
    Column("overruns", 8),
    Column("lost", 5),
    Column("CPU", 5),
    Column("", 11),
)


def sweep(rates: Rates, timed: Timed) -> Sweep:
    """Run at the listed rates; or look for the highest clean one, doubling and then halving steps.

    A rate that a search comes to may be refused, since stated deadlines do not fit into its cycle,
    or its run may fail: then the rate has failed, and those before it count all the same.

    Parameters
    ----------
    rates
        The rates.
    timed
        Runs the plant at one of them.

    Raises
    ------
    InputError
        The first rate of all is refused.
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
    """Return what a run says of its rate. One that was interrupted proves nothing."""
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
        floor=report.floor,
    )


def _trouble(report: TimingReport) -> str:
    """Say what keeps a run from being clean, tier by tier."""
    told = [] if report.cycles else ["no cycle was completed"]
    for tier in report.tiers:
        counts = (
            ("missed a deadline", tier.missed_deadlines),
            ("overran", tier.overruns),
            ("skipped a cycle", tier.skipped_cycles),
        )
        told += [f"{tier.tier} {what} {how_often(count)}" for what, count in counts if count]
    if report.lost_messages:
        told.append(f"messages not recorded: {report.lost_messages:,}")
    return ", ".join(told)


def print_sweep(found: Sweep, console: Console) -> None:
    """Print the rates, on what they were run, and the highest clean one."""
    for line in machine_lines(found):
        console.print(line, highlight=False, markup=False)
    for table in sweep_tables(found):
        print_table(console, table)
    console.print()
    for line in (*trouble_lines(found), conclusion(found)):
        console.print(line, highlight=False, markup=False)


def sweep_tables(found: Sweep) -> list[FigureTable]:
    """Return the rates, and the machine's floor at each."""
    rates = FigureTable("rates", _MEANING, _COLUMNS, [_cells(row) for row in found.rows])
    floors = [
        floor_table("floor", f" at {cycles_per_s(row.rate_hz)} [ms]", row.floor)
        for row in found.rows
        if row.floor
    ]
    return [rates, *floors]


def machine_lines(found: Sweep) -> list[str]:
    """Say on what the rates were run: the load before the first one, and after the last one."""
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
    """Yield rates to try, of which the rows so far tell how they went."""
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


def _cells(row: RateRow) -> tuple[str, ...]:
    return (
        f"{row.rate_hz:.4g}",
        f"{row.cycles:,}",
        f"{1e3 / row.rate_hz:,.2f}",
        *map(ms, (row.loop_p50_us, row.loop_p99_us, row.loop_max_us)),
        f"{row.missed_deadlines:,}",
        f"{row.overruns:,}",
        f"{row.lost_messages:,}",
        figure(row.cpu_percent),
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
