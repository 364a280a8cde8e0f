"""Offers: what share of the clear-sky power the plant can promise for a coming interval.

The central controller keeps a record of past intervals: how the sky looked when each was offered,
and what could have been promised. An offer takes the past intervals that looked most alike, and of
them the share that was there as reliably as the user asks for. A factor, learned from the
plant's own kept and missed offers, corrects what the record gets wrong, so that the long-run rate
of kept intervals holds although the sky drifts (online tracking of a quantile: A. Angelopoulos, E.
Candes and R. Tibshirani, Conformal PID control for time series prediction, arXiv:2307.16895).

Behind power limits nobody sees what the plant could have given. An interval that was kept then says
only that there was at least as much (a right-censored observation: E. Kaplan and P. Meier, J. Am.
Stat. Assoc. 53 (1958), doi:10.1080/01621459.1958.10501452), and no offer goes beyond
what was proven in alike intervals by more than `GROWTH`. What is proven is what the meter showed.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan, nan, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

SAMPLE_S: Final = 10.0
"""The clear-sky index is kept as means over this time [s]."""

WINDOW_S: Final = 1800.0
"""How far back the sky is looked at [s], ..."""

RECENT_S: Final = 300.0
"""... and what counts as now [s]."""

ALIKE: Final = 40
"""How many past intervals an offer rests on."""

MOST_PAST: Final = 300
"""How many past intervals are kept in mind; a new one then replaces the oldest."""

MISSED_SHARE: Final = 0.01
"""An interval is kept if at most this share of its dispatched energy is missing."""

TRACKING: Final = 0.1
"""How fast the factor follows kept and missed intervals."""

LOWEST_FACTOR: Final = 0.4
HIGHEST_FACTOR: Final = 1.2
"""Bounds of the factor: an endless clear sky must not make it grow for ever."""

GROWTH: Final = 1.1
"""How much more than was proven an offer may promise where limits hide the maximum, and how much
more than the last offer while few intervals are known."""

FEATURES: Final = 4

_ROW: Final = FEATURES + 2
_SHARE, _HIDDEN = FEATURES, FEATURES + 1
"""Columns behind how the sky looked: the share, and 1 if there was more."""

_SUMS: Final = (
    *("intervals", "samples", "cycles", "index", "proven", "dispatched_kw", "clear_kw"),
    *("missed_kw", "last_dispatch_kw", "last_clear_kw", "factor", "interval", "last_possible_kw"),
)
_RECORD: Final = np.dtype([(name, "f8") for name in _SUMS])


class OfferSettings(NamedTuple):
    """Which offers a plant makes.

    interval_cycles: Length of an interval. 0: the plant makes no offers.
    lead_cycles: How long before an interval begins its offer is made.
    sample_cycles: Length of a sample of the clear-sky index.
    window_samples: How many samples are looked at.
    miss_rate: Share of the intervals that may be missed.
    first_share: Share of clear sky that is promised before anything is known.
    is_seen: Whether inverters show their maximum also where they are curtailed.
    """

    interval_cycles: int
    lead_cycles: int
    sample_cycles: int
    window_samples: int
    miss_rate: float
    first_share: float
    is_seen: bool


NO_OFFERS: Final = OfferSettings(0, 0, 1, 1, 0.0, 0.0, False)


class OfferMemory(NamedTuple):
    """What the central controller remembers for its offers. `observe` changes it in place.

    sky: Clear-sky index of the last `WINDOW_S`, the newest last; NaN before the run.
    within: That of the samples of the interval under way.
    past: A row for each past interval: how the sky looked, the share, and 1 if there was more.
    open: How the sky looked, and the share, of the interval under way and of the coming one.
    sums: One record: how many intervals are past, the factor, and counts and sums of the interval
        and the sample under way.
    """

    sky: NDArray[np.float64]
    within: NDArray[np.float64]
    past: NDArray[np.float64]
    open: NDArray[np.float64]
    sums: Any


def nothing_offered(settings: OfferSettings) -> NDArray[np.float64]:
    """Return an empty memory as one array, see `memory_of`."""
    window, within = _lengths(settings)
    values = np.zeros(window + within + MOST_PAST * _ROW + 2 * (FEATURES + 1) + len(_SUMS))
    memory = memory_of(values, settings)
    memory.open[:] = nan
    memory.sums[0].factor = 1.0
    begin_run(memory, settings)
    return values


def begin_run(memory: OfferMemory, settings: OfferSettings) -> None:
    """Close the last interval of the run before; of that, keep the past intervals alone."""
    _close_interval(memory, settings)
    for name in {*_SUMS} - {"intervals", "factor"}:
        memory.sums[name] = 0.0
    memory.sky[:] = nan
    memory.open[:] = nan  # Nobody has offered the first interval.
    memory.open[0, _SHARE] = settings.first_share


def memory_of(values: NDArray[np.float64], settings: OfferSettings) -> OfferMemory:
    """Return the parts of a memory that is one array; they are views of it."""
    window, within = _lengths(settings)
    past = window + within
    offered = past + MOST_PAST * _ROW
    sums = offered + 2 * (FEATURES + 1)
    return OfferMemory(
        values[:window],
        values[window:past],
        values[past:offered].reshape((MOST_PAST, _ROW)),
        values[offered:sums].reshape((2, FEATURES + 1)),
        values[sums:].view(_RECORD).view(np.recarray),
    )


def known_intervals(values: Sequence[float]) -> int:
    """Return how many past intervals a memory knows that is one array."""
    return int(values[-len(_SUMS) + _SUMS.index("intervals")])


def _lengths(settings: OfferSettings) -> tuple[int, int]:
    within = max(settings.interval_cycles // settings.sample_cycles, 1)
    return settings.window_samples, within


def observe(
    memory: OfferMemory,
    settings: OfferSettings,
    cycle: int,
    impp_kw: float,
    metered_kw: float,
    dispatch_kw: float,
    clear_sky_kw: float,
) -> float:
    """Take in a cycle from 0 on; return the share to offer, NaN if none is due.

    Parameters
    ----------
    memory
        Changed in place.
    settings, cycle
        Which offers are made, and the number of the cycle.
    impp_kw
        Sum of all IMPPs for the cycle [kW].
    metered_kw
        What the plant's meter showed of the cycle before [kW]; NaN if nothing came.
    dispatch_kw, clear_sky_kw
        Dispatch, and power under a clear sky, of the cycle [kW].
    """
    sums = memory.sums[0]
    _take_meter(memory, settings, metered_kw)
    interval = cycle // settings.interval_cycles
    if interval != sums.interval:
        _close_interval(memory, settings)
        sums.interval = interval
    sums.last_dispatch_kw, sums.last_clear_kw = dispatch_kw, clear_sky_kw
    sums.last_possible_kw = impp_kw
    if clear_sky_kw > 0.0:
        sums.cycles += 1.0
        sums.index += impp_kw / clear_sky_kw
        if sums.cycles >= settings.sample_cycles:
            _close_sample(memory, settings)
    if not is_due(settings, cycle):
        return nan
    looks = _looks(memory.sky)
    share = offered_share(memory, settings, looks)
    memory.open[1, :FEATURES] = looks
    memory.open[1, _SHARE] = share
    return share


def is_due(settings: OfferSettings, cycle: int) -> bool:
    """Whether an offer is made in a cycle; also in each arming round, to test its link."""
    return cycle < 0 or (cycle + settings.lead_cycles) % settings.interval_cycles == 0


def offered_share(
    memory: OfferMemory, settings: OfferSettings, looks: NDArray[np.float64]
) -> float:
    """Return the share of clear sky that past intervals which looked like this one had."""
    count = int(min(memory.sums[0].intervals, MOST_PAST))
    if count == 0 or isnan(looks[0]):
        return settings.first_share
    past = memory.past[:count]
    distance = np.zeros(count)
    for column in range(FEATURES):
        _, spread = _mean_and_spread(past[:, column])
        if spread > 0.0:
            distance += ((past[:, column] - looks[column]) / spread) ** 2
    alike = past[np.argsort(distance, kind="mergesort")[:ALIKE]]
    share, most = _reliable_share(alike, settings)
    share = min(share * float(memory.sums[0].factor), most)
    if count < ALIKE:  # Few intervals say little of bad luck.
        share = min(share, GROWTH * float(memory.open[0, _SHARE]))
    return share


def _reliable_share(alike: NDArray[np.float64], settings: OfferSettings) -> tuple[float, float]:
    """Return the largest share that was there often enough, and the most that may be promised."""
    shares, hidden = alike[:, _SHARE], alike[:, _HIDDEN]
    most = float(np.max(shares))
    if np.max(hidden) > 0.0:
        most *= GROWTH
    # A censored interval comes after one that ended at the same share.
    order = np.argsort(shares + 1e-9 * hidden, kind="mergesort")
    kept, left = 1.0, len(shares)
    for place in order:
        if hidden[place] == 0.0:
            kept *= 1.0 - 1.0 / left
            if kept < 1.0 - settings.miss_rate:
                return float(shares[place]), most
        left -= 1
    return most, most


def _take_meter(memory: OfferMemory, settings: OfferSettings, metered_kw: float) -> None:
    """Add what the meter showed of the cycle before to the sums of its interval."""
    sums = memory.sums[0]
    if isnan(metered_kw) or sums.last_clear_kw <= 0.0:
        return
    sums.dispatched_kw += sums.last_dispatch_kw
    sums.clear_kw += sums.last_clear_kw
    missed_kw = max(sums.last_dispatch_kw - metered_kw, 0.0)
    if settings.is_seen:  # A smaller promise would not mend what control missed.
        missed_kw = min(missed_kw, max(sums.last_dispatch_kw - sums.last_possible_kw, 0.0))
    sums.missed_kw += missed_kw
    sums.proven += metered_kw / sums.last_clear_kw


def _close_sample(memory: OfferMemory, settings: OfferSettings) -> None:
    sums, sky = memory.sums[0], memory.sky
    cycles = sums.cycles
    mean = sums.index / cycles
    sky[:-1] = sky[1:].copy()
    sky[-1] = mean
    place = int(sums.samples)
    if place < len(memory.within):
        memory.within[place] = mean if settings.is_seen else sums.proven / cycles
    sums.samples += 1.0
    sums.cycles = sums.index = sums.proven = 0.0


def _close_interval(memory: OfferMemory, settings: OfferSettings) -> None:
    """Judge the interval that ended, and go on to the one that was offered last."""
    sums, looks = memory.sums[0], memory.open[0]
    if sums.dispatched_kw > 0.0:
        is_missed = sums.missed_kw > MISSED_SHARE * sums.dispatched_kw
        if not isnan(looks[0]):
            change = 1.0 + TRACKING * (settings.miss_rate - (1.0 if is_missed else 0.0))
            sums.factor = min(max(sums.factor * change, LOWEST_FACTOR), HIGHEST_FACTOR)
            share = firm_share(memory.within[: int(sums.samples)])
            is_hidden = not (settings.is_seen or is_missed)
            if is_hidden:
                share = sums.dispatched_kw / sums.clear_kw
            row = memory.past[int(sums.intervals) % MOST_PAST]
            row[:FEATURES] = looks[:FEATURES]
            row[_SHARE] = share
            row[_HIDDEN] = 1.0 if is_hidden else 0.0
            sums.intervals += 1.0
    if not isnan(memory.open[1, _SHARE]):
        memory.open[0] = memory.open[1]
    sums.samples = sums.dispatched_kw = sums.clear_kw = sums.missed_kw = 0.0


def firm_share(index: NDArray[np.float64]) -> float:
    """Return the largest share of which at most `MISSED_SHARE` is missing, by samples of the index.

    With the samples sorted, what is missing of a share c above the first m of them is m c less
    their sum; it is `MISSED_SHARE` of all that is promised, n c, at c = sum / (m - share n).
    """
    ordered = np.sort(index)
    count, below = len(ordered), 0.0
    for place in range(count):
        below += ordered[place]
        missed = place + 1 - MISSED_SHARE * count
        if missed > 0.0:
            share = float(below / missed)
            if place + 1 == count or share <= ordered[place + 1]:
                return share
    return nan


def _looks(index: NDArray[np.float64]) -> NDArray[np.float64]:
    """Say how the sky looks: mean now and of the window, spread, and what is seldom undercut."""
    known = index[~np.isnan(index)]
    looks = np.full(FEATURES, nan)
    if len(known) > 0:
        recent = max(len(index) * RECENT_S / WINDOW_S, 1.0)
        looks[0], _ = _mean_and_spread(known[-int(recent) :])
        looks[1], looks[2] = _mean_and_spread(known)
        looks[3] = np.sort(known)[len(known) // 10]
    return looks


def _mean_and_spread(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean and standard deviation, added up one by one as Numba does."""
    added = 0.0
    for value in values:
        added += value
    mean = added / len(values)
    squares = 0.0
    for value in values:
        squares += (value - mean) * (value - mean)
    return mean, sqrt(squares / len(values))
