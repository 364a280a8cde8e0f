"""Runs at several rates, one after another: how fast a plant can go on this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import msgspec

from bus_schemas.errors import InputError
from launch_scripts.supervision import RunFailure
from results.timing.report import Host, TimingReport
from results.timing.run_timing import WHOLE_LOOP

HIGHEST_HZ: Final = 1000.0
LOWEST_HZ: Final = 1.0 / 3600.0
_AUTO_FROM_HZ: Final = 5.0

RateOutcome: TypeAlias = Literal["clean", "not clean", "failed", "interrupted"]
"""Of a rate that was interrupted nothing is proved."""

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
    """The run at one rate; `reason` says why it failed, or what was late or lost in which tier."""

    rate_hz: float
    outcome: RateOutcome
    reason: str = ""
    cycles: int = 0
    late_cycles: int = 0
    lost_messages: int = 0
    loop_p50_us: float | None = None
    loop_p99_us: float | None = None
    loop_max_us: float | None = None
    host: Host | None = None


class Sweep(msgspec.Struct, frozen=True):
    """Runs at several rates, ascending; `highest_clean_hz` is None if none was clean."""

    rows: tuple[RateRow, ...]
    highest_clean_hz: float | None

    @property
    def interrupted(self) -> bool:
        return any(row.outcome == "interrupted" for row in self.rows)

    @property
    def too_fast_hz(self) -> float | None:
        """The lowest rate above the highest clean one that proved too fast, if there is one."""
        proved = (row.rate_hz for row in self.rows if row.outcome in {"failed", "not clean"})
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
    if not LOWEST_HZ <= rate_hz <= HIGHEST_HZ:
        raise InputError(
            f"--rate: expected from one cycle an hour (0.000278) to {HIGHEST_HZ:g} cycles/s, "
            f"got {text}"
        )
    return rate_hz


def sweep(rates: Rates, timed: Callable[[float], TimingReport]) -> Sweep:
    """Run at the listed rates; or search for the highest clean one, doubling, then halving steps.

    A search runs a rate that was not clean once more, and the second run counts: one stall of the
    machine must not end it. A later rate may be refused because stated deadlines do not fit
    into its cycle, or its run may fail: that rate has failed, and the others still count. Only if
    the very first rate is refused, so is the sweep.
    """
    rows: dict[float, RateRow] = {}
    for rate_hz in _search(rates.search_hz, rows) if rates.search_hz else rates.listed_hz:
        for _ in range(2 if rates.search_hz else 1):
            try:
                row = rate_row(timed(rate_hz))
            except KeyboardInterrupt:
                row = RateRow(rate_hz, "interrupted")
            except (RunFailure, InputError) as failure:
                if not rows and isinstance(failure, InputError):
                    raise
                row = RateRow(rate_hz, "failed", str(failure).splitlines()[0])
            rows[rate_hz] = row
            if row.outcome != "not clean":
                break
        if row.outcome == "interrupted":
            break
    return _swept(rows)


def _swept(rows: dict[float, RateRow]) -> Sweep:
    in_order = tuple(rows[rate_hz] for rate_hz in sorted(rows))
    clean_hz = max((row.rate_hz for row in in_order if row.outcome == "clean"), default=None)
    return Sweep(in_order, clean_hz)


def _search(search_hz: tuple[float, float], rows: dict[float, RateRow]) -> Iterator[float]:
    """Yield rates to try; each is run, and has its row, before the next one is asked for."""
    rate_hz, highest_hz = search_hz
    yield rate_hz
    while rows[rate_hz].outcome == "clean" and rate_hz < highest_hz:
        rate_hz = min(2.0 * rate_hz, highest_hz)
        yield rate_hz
    while (done := _swept(rows)).highest_clean_hz is not None and done.too_fast_hz is not None:
        if done.too_fast_hz <= done.highest_clean_hz * _CLOSE_ENOUGH:
            return
        rate_hz = float(f"{(done.highest_clean_hz * done.too_fast_hz) ** 0.5:.3g}")
        yield rate_hz


def rate_row(report: TimingReport) -> RateRow:
    loop = next((row.times for row in report.times if row.of == WHOLE_LOOP), None)
    outcome: RateOutcome = "clean" if report.clean else "not clean"
    reasons = [
        f"{tier.tier}: missed deadlines {tier.missed_deadlines}, overruns {tier.overruns}, "
        f"skipped cycles {tier.skipped_cycles}"
        for tier in report.tiers
        if tier.missed_deadlines or tier.overruns or tier.skipped_cycles
    ]
    if report.lost_messages:
        reasons.append(f"messages not recorded: {report.lost_messages:,}")
    return RateRow(
        rate_hz=report.rate_hz,
        outcome="interrupted" if report.interrupted else outcome,
        reason=", ".join(reasons),
        cycles=report.cycles,
        late_cycles=report.late_cycles,
        lost_messages=report.lost_messages or 0,
        loop_p50_us=loop.p50_us if loop else None,
        loop_p99_us=loop.p99_us if loop else None,
        loop_max_us=loop.max_us if loop else None,
        host=report.host,
    )
