"""Runs at several rates, one after another: how fast a plant can go on this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import msgspec

from bus_schemas.errors import InputError
from launch_scripts.launcher.supervision import RunFailure
from studies.tables import Cell, Column, Table, counted, key_column, word_column
from studies.timing.report import Host, TimingReport
from studies.timing.run_timing import LOOP, WHOLE_LOOP, total
from studies.timing.tables import cycles_per_s, host_lines

HIGHEST_HZ: Final = 1000.0
LOWEST_HZ: Final = 1.0 / 3600.0
_AUTO_FROM_HZ: Final = 5.0

NOT_CLEAN: Final = "not clean"

_CLOSE_ENOUGH: Final = 1.1
"""The search ends where the lowest rate that fails is no further above the highest clean one."""

_EXPECTED: Final = "cycles a second such as 20, several such as 5,10,20, 1..200 or auto"


@dataclass(frozen=True, slots=True)
class Rates:
    """Rates to run at: those listed, or a search for the highest clean one in a range."""

    listed_hz: tuple[float, ...] = ()
    search_hz: tuple[float, float] | None = None

    @property
    def single_hz(self) -> float | None:
        """The rate, if it is one; None if this is a sweep."""
        return self.listed_hz[0] if len(self.listed_hz) == 1 else None


class RateRow(msgspec.Struct, frozen=True):
    """The run at one rate; of one that was interrupted nothing is proved.

    `trouble` says what was missed, overran, was skipped or lost, and in which tier; `failed` why
    the run failed.
    """

    rate_hz: float
    cycles: int = 0
    late_cycles: int = 0
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
        return "clean" if self.clean else NOT_CLEAN


class Sweep(msgspec.Struct, frozen=True):
    """Runs at several rates, ascending; `highest_clean_hz` is None if none was clean."""

    rows: tuple[RateRow, ...]
    highest_clean_hz: float | None
    interrupted: bool

    @property
    def too_fast_hz(self) -> float | None:
        """The lowest rate above the highest clean one that proved too fast, if there is one."""
        proved = (row.rate_hz for row in self.rows if row.outcome in {"failed", NOT_CLEAN})
        clean_hz = self.highest_clean_hz or 0.0
        return min((rate_hz for rate_hz in proved if rate_hz > clean_hz), default=None)


def parse_rates(text: str) -> Rates:
    """Read the value of `--rate`."""
    if text == "auto":
        return Rates(search_hz=(_AUTO_FROM_HZ, HIGHEST_HZ))
    if ".." in text:
        low, _, high = text.partition("..")
        search = _rate_hz(low, text), _rate_hz(high, text)
        if search[0] >= search[1]:
            raise InputError(f"--rate: expected a range from low to high, got {text}")
        return Rates(search_hz=search)
    listed = tuple(_rate_hz(part, text) for part in text.split(","))
    if len(set(listed)) < len(listed):
        raise InputError(f"--rate: expected each rate once, got {text}")
    return Rates(listed_hz=listed)


def _rate_hz(part: str, text: str) -> float:
    try:
        rate_hz = float(part)
    except ValueError:
        raise InputError(f"--rate: expected {_EXPECTED}, got {text}") from None
    if rate_hz > HIGHEST_HZ:
        raise InputError(
            f"--rate: expected at most {HIGHEST_HZ:g} cycles/s, got {text}; timers wake a process "
            "about 0.1 ms late, so a cycle below 1 ms leaves no time for its stages"
        )
    if not rate_hz >= LOWEST_HZ:
        raise InputError(f"--rate: expected at least one cycle an hour (0.000278), got {text}")
    return rate_hz


def sweep(rates: Rates, timed: Callable[[float], TimingReport]) -> Sweep:
    """Run at the listed rates; or search for the highest clean one, doubling, then halving steps.

    A search runs a rate that was not clean once more, and the second run counts: one stall of the
    machine must not end it. A rate of a search may be refused because stated deadlines do not fit
    into its cycle, or its run may fail: that rate has failed, and the others still count. Only if
    the very first rate is refused, so is the sweep.
    """
    rows: dict[float, RateRow] = {}
    for rate_hz in _search(rates.search_hz, rows) if rates.search_hz else rates.listed_hz:
        for _ in range(2 if rates.search_hz else 1):
            try:
                row = rate_row(timed(rate_hz))
            except KeyboardInterrupt:
                row = RateRow(rate_hz, interrupted=True)
            except RunFailure as failure:
                row = RateRow(rate_hz, failed=str(failure).splitlines()[0])
            except InputError as error:
                if not rows:
                    raise
                row = RateRow(rate_hz, failed=str(error))
            rows[rate_hz] = row
            if row.outcome != NOT_CLEAN:
                break
        if row.interrupted:
            break
    return _found(rows)


def _found(rows: dict[float, RateRow]) -> Sweep:
    in_order = tuple(rows[rate_hz] for rate_hz in sorted(rows))
    clean_hz = max((row.rate_hz for row in in_order if row.clean), default=None)
    return Sweep(in_order, clean_hz, any(row.interrupted for row in in_order))


def _search(search_hz: tuple[float, float], rows: dict[float, RateRow]) -> Iterator[float]:
    """Yield rates to try; each is run, and has its row, before the next one is asked for."""
    rate_hz, highest_hz = search_hz
    yield rate_hz
    while rows[rate_hz].clean and rate_hz < highest_hz:
        rate_hz = min(2.0 * rate_hz, highest_hz)
        yield rate_hz
    while (found := _found(rows)).highest_clean_hz is not None and found.too_fast_hz is not None:
        if found.too_fast_hz <= found.highest_clean_hz * _CLOSE_ENOUGH:
            return
        rate_hz = float(f"{(found.highest_clean_hz * found.too_fast_hz) ** 0.5:.3g}")
        yield rate_hz


def rate_row(report: TimingReport) -> RateRow:
    rows = {(row.measure, row.of): row.times for row in report.times}
    loop = rows.get((LOOP, WHOLE_LOOP))
    return RateRow(
        rate_hz=report.rate_hz,
        cycles=report.cycles,
        late_cycles=report.late_cycles,
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
    """Say what went wrong in a run, tier by tier."""
    found = [] if report.cycles else ["no cycle was completed"]
    for tier in report.tiers:
        counts = (
            ("missed a deadline", tier.missed_deadlines),
            ("overran", tier.overruns),
            ("skipped a cycle", tier.skipped_cycles),
        )
        found += [f"{tier.tier} {what} {counted(count, 'time')}" for what, count in counts if count]
    if report.lost_messages:
        found.append(f"messages not recorded: {report.lost_messages:,}")
    return ", ".join(found)


def sweep_table(found: Sweep) -> Table:
    columns = (
        key_column("rate"),
        Column("cycles"),
        Column("cycle", "ms", 2),
        Column("loop p50", "ms"),
        Column("loop p99", "ms"),
        Column("loop max", "ms"),
        *map(Column, ("late cycles", "lost")),
        Column("CPU", "%", 0),
        word_column(""),
    )
    rows: list[tuple[Cell, ...]] = []
    for row in found.rows:
        loop_us = (row.loop_p50_us, row.loop_p99_us, row.loop_max_us)
        loop_ms = (None if value_us is None else value_us / 1e3 for value_us in loop_us)
        counts = (row.late_cycles, row.lost_messages, row.cpu_percent)
        rate, cycle_ms = f"{row.rate_hz:.4g}", 1e3 / row.rate_hz
        rows.append((rate, row.cycles, cycle_ms, *loop_ms, *counts, row.outcome))
    return Table("Rates [cycles/s]", columns, tuple(rows))


def machine_lines(found: Sweep) -> list[str]:
    """Say on which machine, with the load before the first rate and after the last one."""
    hosts = [row.host for row in found.rows if row.host is not None]
    if not hosts:
        return []
    return host_lines(msgspec.structs.replace(hosts[-1], load_before=hosts[0].load_before))


def trouble_lines(found: Sweep) -> list[str]:
    """Say of each rate what went wrong, also of clean ones."""
    return [
        f"{cycles_per_s(row.rate_hz)} {row.outcome}: {row.failed or row.trouble}"
        for row in found.rows
        if (row.failed or row.trouble) and not row.interrupted
    ]


def conclusion(found: Sweep) -> str:
    """Say how fast the plant can go."""
    if found.highest_clean_hz is not None:
        at_least = "at least " if found.too_fast_hz is None else ""
        return (
            f"highest clean rate: {at_least}{cycles_per_s(found.highest_clean_hz)} (at most 1 % of "
            "the cycles late, no message lost)"
        )
    if found.interrupted:
        return "interrupted before a rate was found to be clean"
    lowest_hz = found.rows[0].rate_hz
    what = f"no rate was clean: {len(found.rows)} tried, from {cycles_per_s(lowest_hz)} on"
    if lowest_hz <= LOWEST_HZ or all(row.failed for row in found.rows):
        return what
    below = f"{max(lowest_hz / 10.0, LOWEST_HZ):.3g}..{lowest_hz:.4g}"
    return f"{what}; slower ones are tried by --rate {below}"
