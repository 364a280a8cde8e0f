"""How well a plant followed a regulation signal such as PJM's RegD: requests and PJM's score.

Only the time counts in which regulation was offered. The response is what the plant delivered
beyond its commitment, in per unit of the capacity.

The score follows PJM Manual 12, section 4.5.6, as it stood when RegD was a product of its own
(until 2025), read from two public implementations. docs/metrics.md names them, has all formulas,
and says what was chosen where they differ. Signal and response are sampled every 10 s. A window is
30 samples, 5 minutes of the clock. For each shift d = 0, 10, ... 300 s, Corr(d) is Pearson's r of
the signal over the window and the response over the shifted window, and Delay(d) = 1 - d / 300 s,
but 1 at d = 10 s. Accuracy and delay of a window are Corr and Delay at the shift where their sum is
greatest, the least such shift. A flat signal (standard deviation below 0.01) is scored by slopes
instead. The precision of an hour is 1 - mean |R - S| / mean |S|. The accuracy of a window that
opposes the signal counts as 0.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recordings.read.series import RunSeries

Values: TypeAlias = NDArray[np.float64]

REQUEST_S: Final = 2.0
"""PJM sends a request every 2 s."""

TOLERANCES_PERCENT: Final = {"regd-strict": 0.1, "regd": 1.0}
"""In % of the plant's rating."""

_SCORE: Final = ("accuracy", "delay", "precision", "score")

_PAUSE_S: Final = 60.0
_SAMPLE_S: Final = 10
_WINDOW: Final = 30
_LATENCY: Final = 1
_FLAT_STD: Final = 0.01
_CONSTANT_STD: Final = 1e-5
_NS: Final = 1_000_000_000


def regulation_figures(series: RunSeries) -> dict[str, float | None]:
    """Compute how well a plant followed its regulation signal; nothing if none was offered.

    A signal of 1 asks for the capacity on top of the commitment. Its mileage is the sum of
    |S(k+1) - S(k)| over the cycles offered, divided by their hours.
    """
    capacity_kw = series.plan.site.regulation_capacity_kw
    offered = offered_cycles(series.regulation_kw, series.cycle_s) & series.known
    if capacity_kw == 0.0 or not offered.any():
        return {}
    signal = series.regulation_kw / capacity_kw
    response = (series.delivered_kw - series.commitment_kw) / capacity_kw
    offered_h = int(offered.sum()) * series.cycle_s / 3600.0
    steps = np.abs(np.diff(signal))[offered[1:] & offered[:-1]]
    score = performance_score(signal, response, offered, series.times[0], series.cycle_s)
    return {
        "capacity": capacity_kw,
        "offered": offered_h,
        "signal-mileage": float(steps.sum()) / offered_h,
        **_requests_to_tolerances(series),
        **(score or {}),
    }


def offered_cycles(regulation_kw: Values, cycle_s: float) -> NDArray[np.bool_]:
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


def _requests_to_tolerances(series: RunSeries) -> dict[str, float | None]:
    figures: dict[str, float | None] = {}
    for name, percent in TOLERANCES_PERCENT.items():
        found = requests_fulfilled(series, series.rating_kw * percent / 100.0)
        figures[name] = found.percent
        if found.feasible_percent is not None:
            figures[name.replace("regd", "regd-feasible")] = found.feasible_percent
    return figures


class Fulfilled(NamedTuple):
    """Share of the requests that were fulfilled, in %: of all, and of the feasible, if any."""

    percent: float
    feasible_percent: float | None


def requests_fulfilled(series: RunSeries, tolerance_kw: float) -> Fulfilled:
    """Return which share of the requests of a run that offers regulation was fulfilled.

    A request lasts 2 s, or a cycle where that is longer. It is fulfilled if |delivered - dispatch|
    is within the tolerance in every cycle that begins in it. It is feasible, the paper's condition,
    if available power was at least the dispatch in each of its cycles. The paper gives 99.88 %
    without a tolerance.
    """
    offered = offered_cycles(series.regulation_kw, series.cycle_s) & series.known
    # The number of the 2 s of the clock in which each cycle begins.
    begins_ns = round(series.cycle_s * 1e9) * np.arange(series.cycles) + series.start_time_ns
    request = (begins_ns // round(REQUEST_S * 1e9))[offered]
    deviation_kw = np.abs(series.delivered_kw - series.desired_kw)[offered]
    is_able = (series.available_kw >= series.desired_kw)[offered]
    begins = np.flatnonzero(np.diff(request, prepend=request[0] - 1))
    fulfilled = np.maximum.reduceat(deviation_kw, begins) <= tolerance_kw
    feasible = np.logical_and.reduceat(is_able, begins)
    of_feasible = 100.0 * float(fulfilled[feasible].mean()) if feasible.any() else None
    return Fulfilled(100.0 * float(fulfilled.mean()), of_feasible)


def performance_score(
    signal: Values,
    response: Values,
    offered: NDArray[np.bool_],
    begins: pd.Timestamp,
    cycle_s: float,
) -> dict[str, float] | None:
    """Score a plant's response to a regulation signal, both in per unit of the capacity, (T,).

    Returns the means of the hours of the clock, each weighted with its windows. None where there is
    nothing to score: a cycle is longer than 10 s, no window of 5 minutes is wholly within the time
    offered, or the signal is 0 all the time.
    """
    if cycle_s > _SAMPLE_S:
        return None
    # Second of the local clock and cycle of each full 10 s, shape (K,).
    begins_ns = int(begins.tz_localize(None).as_unit("ns").value)
    step_ns, cycle_ns = _SAMPLE_S * _NS, round(cycle_s * _NS)
    end_ns = begins_ns + len(signal) * cycle_ns
    clock_ns = np.arange(-(-begins_ns // step_ns) * step_ns, end_ns, step_ns)
    clock_s, cycle = clock_ns // _NS, (clock_ns - begins_ns) // cycle_ns
    # First samples of the windows, on 5 minutes of the clock, that are offered throughout.
    first = np.flatnonzero(clock_s % (_WINDOW * _SAMPLE_S) == 0)
    first = first[first + _WINDOW <= len(clock_s)]
    first = first[offered[cycle][first[:, None] + np.arange(_WINDOW)].all(axis=1)]
    hour_of_first = clock_s[first] // 3600
    scores, weights = [], []
    for hour in np.unique(hour_of_first):
        firsts = first[hour_of_first == hour]
        score = _hour_score(signal[cycle], response[cycle], firsts)
        if score is not None:
            scores.append(score)
            weights.append(len(firsts))
    if not scores:
        return None
    means = np.average(scores, axis=0, weights=weights)
    return dict(zip(_SCORE, map(float, means), strict=True))


def _hour_score(signal: Values, response: Values, first: NDArray[np.intp]) -> list[float] | None:
    """Return the score of an hour whose windows begin at these samples."""
    window = first[:, None] + np.arange(_WINDOW)
    asked = np.abs(signal[window]).mean()
    if asked == 0.0:
        return None
    # NaN beyond the end of the run: there is no response to look at.
    beyond = np.concatenate([response, np.full(_WINDOW, np.nan)])
    shifted = sliding_window_view(beyond, _WINDOW)[first[:, None] + np.arange(_WINDOW + 1)]
    accuracy, delay = window_scores(signal[window], shifted)
    precision = 1.0 - np.abs(response[window] - signal[window]).mean() / asked
    parts = [float(accuracy.mean()), float(delay.mean()), float(np.clip(precision, 0.0, 1.0))]
    return [*parts, sum(parts) / 3.0]


def window_scores(signal: Values, shifted: Values) -> tuple[Values, Values]:
    """Score W windows of 5 minutes for accuracy and delay, both from 0 to 1.

    The signal of each window, every 10 s, is of shape (W, 30), the response over the same window,
    shifted by 0, 10, ... 300 s, of (W, 31, 30). It is NaN where there is none, never at shift 0.
    """
    correlation = _correlations(signal, shifted)
    promptness = 1.0 - np.arange(_WINDOW + 1) / _WINDOW
    promptness[: _LATENCY + 1] = 1.0
    windows = np.arange(len(signal))
    best = np.where(np.isnan(correlation), -np.inf, correlation + promptness).argmax(axis=1)
    accuracy, delay = correlation[windows, best], promptness[best]
    # Where the response never moves, it neither follows nor is it prompt.
    still = (np.nan_to_num(shifted.std(axis=2)) < _CONSTANT_STD).all(axis=1)
    accuracy[still], delay[still] = 0.0, 0.0
    flat = signal.std(axis=1) < _FLAT_STD
    accuracy[flat] = 1.0 - np.abs(_slopes(signal[flat]) - _slopes(shifted[flat, 0]))
    delay[flat] = 1.0
    return accuracy.clip(0.0, 1.0), delay


def _correlations(signal: Values, shifted: Values) -> Values:
    """Pearson's r of each window and shift, shape (W, 31); 0 where either side is constant."""
    x = signal - signal.mean(axis=1, keepdims=True)
    y = shifted - shifted.mean(axis=2, keepdims=True)
    signal_std, shifted_std = signal.std(axis=1)[:, None], shifted.std(axis=2)
    # A NaN is not below anything: windows without a response stay NaN.
    moves = (signal_std > 0.0) & ~(shifted_std < _CONSTANT_STD)
    correlation: Values = np.zeros_like(shifted_std)
    covariance = np.einsum("wi,wdi->wd", x, y) / _WINDOW
    np.divide(covariance, signal_std * shifted_std, out=correlation, where=moves)
    return correlation


def _slopes(windows: Values) -> Values:
    """Slope of the least-squares line through each window, per sample, shape (W,)."""
    index = np.arange(_WINDOW) - (_WINDOW - 1) / 2.0
    return np.asarray(windows @ index / (index @ index))
