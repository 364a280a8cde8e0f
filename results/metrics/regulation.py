"""How well a plant followed a regulation signal such as PJM's RegD.

Only the time counts in which regulation was offered. The response is what the plant delivered
beyond its commitment, in per unit of the capacity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recordings.read.series import RunSeries
from results.metrics.performance import PerformanceScore, performance_score

REQUEST_S: Final = 2.0
"""PJM sends a request every 2 s."""

TOLERANCES_PERCENT: Final = (0.1, 1.0)
"""In % of the plant's rating."""

_PAUSE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class RequestsFulfilled:
    """Requests of a regulation signal that were fulfilled entirely.

    A request lasts 2 s, or a cycle where that is longer. It is fulfilled if
    |delivered - dispatch| is within the tolerance (in % of the rating) in every cycle that begins
    in it. It is feasible, the paper's condition, if available power was at least the dispatch in
    each of its cycles. The paper gives 99.88 % without a tolerance.
    """

    tolerance_percent: float
    requests: int
    fulfilled: int
    feasible: int
    feasible_fulfilled: int

    @property
    def fulfilled_percent(self) -> float:
        """Requests fulfilled, in % of all."""
        return 100.0 * self.fulfilled / self.requests

    @property
    def feasible_fulfilled_percent(self) -> float | None:
        """The same of the feasible requests alone; None where there were none."""
        return 100.0 * self.feasible_fulfilled / self.feasible if self.feasible else None


@dataclass(frozen=True, slots=True)
class RegulationMetrics:
    """A plant under a regulation signal S; S = 1 asks for the capacity on top of the commitment.

    The mileage is the sum of |S(k+1) - S(k)| over the cycles offered, divided by their hours.
    `requests` has an entry for each tolerance. `performance` is None with nothing to score.
    """

    capacity_kw: float
    offered_h: float
    signal_mileage_per_hour: float
    requests: tuple[RequestsFulfilled, ...]
    performance: PerformanceScore | None


def regulation_metrics(series: RunSeries) -> RegulationMetrics | None:
    """Work out how well a plant followed its regulation signal; None if none was offered."""
    capacity_kw = series.regulation_capacity_kw
    offered = offered_cycles(series.regulation_kw, series.cycle_s) & series.known
    if capacity_kw == 0.0 or not offered.any():
        return None
    signal = series.regulation_kw / capacity_kw
    delivered_kw = series.delivered_kw
    response = (delivered_kw - series.commitment_kw) / capacity_kw
    offered_h = int(offered.sum()) * series.cycle_s / 3600.0
    steps = np.abs(np.diff(signal))[offered[1:] & offered[:-1]]
    # The number of the 2 s of the clock in which each cycle begins.
    begins_ns = round(series.cycle_s * 1e9) * np.arange(series.cycles) + series.start_time_ns
    request = begins_ns // round(REQUEST_S * 1e9)
    return RegulationMetrics(
        capacity_kw=capacity_kw,
        offered_h=offered_h,
        signal_mileage_per_hour=float(steps.sum()) / offered_h,
        requests=_requests_fulfilled(
            (delivered_kw - series.dispatch_kw)[offered],
            request[offered],
            (series.available_kw >= series.dispatch_kw)[offered],
            float(series.rating_kw.sum()),
        ),
        performance=performance_score(signal, response, offered, series.times[0], series.cycle_s),
    )


def offered_cycles(regulation_kw: NDArray[np.float64], cycle_s: float) -> NDArray[np.bool_]:
    """Read from the regulation alone in which cycles it was offered.

    A run says 0 both for a request of nothing and for no request at all. A real signal passes
    through 0 but does not stay there (two days of RegD never are exactly 0), so a 0 that lasts a
    minute or more, or that stands at an end of the run, is taken for no request. Shape (T,).
    """
    # Where the regulation is not known (NaN), the signal is taken to go on.
    asked = np.flatnonzero(regulation_kw)
    gap_s = (np.diff(asked) - 1) * cycle_s
    change = np.zeros(len(regulation_kw) + 1, dtype=np.int64)
    if len(asked):
        pauses = np.flatnonzero(gap_s >= _PAUSE_S)
        change[asked[np.concatenate(([0], pauses + 1))]] += 1
        change[asked[np.concatenate((pauses, [-1]))] + 1] -= 1
    return np.cumsum(change)[:-1] > 0


def _requests_fulfilled(
    deviation_kw: NDArray[np.float64],
    request: NDArray[np.int64],
    is_able: NDArray[np.bool_],
    rating_kw: float,
) -> tuple[RequestsFulfilled, ...]:
    """Count the requests that were fulfilled and feasible, at each tolerance.

    Cycle by cycle, shape (K,): delivered power less the dispatch, the number of the request that
    the cycle belongs to, ascending, and whether available power was at least the dispatch.
    """
    begins = np.flatnonzero(np.diff(request, prepend=request[0] - 1))
    largest_kw = np.maximum.reduceat(np.abs(deviation_kw), begins)
    feasible = np.logical_and.reduceat(is_able, begins)
    counts = []
    for percent in TOLERANCES_PERCENT:
        fulfilled = largest_kw <= rating_kw * percent / 100.0
        counts.append(
            RequestsFulfilled(
                tolerance_percent=percent,
                requests=len(begins),
                fulfilled=int(fulfilled.sum()),
                feasible=int(feasible.sum()),
                feasible_fulfilled=int((feasible & fulfilled).sum()),
            )
        )
    return tuple(counts)
