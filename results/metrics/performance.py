"""PJM's performance score of a regulating plant: accuracy, delay and precision, hour by hour.

The rules are those of PJM Manual 12, section 4.5.6, as they stood when RegD was a product of its
own (until 2025), read from two public implementations. docs/metrics.md names them, has all
formulas, and says what was chosen where they differ.

Signal S and response R are in per unit of the capacity, sampled every 10 s. A window is 30 samples,
5 minutes of the clock. For each shift d = 0, 10, ... 300 s, Corr(d) is Pearson's r of S over the
window and R over the shifted window, and Delay(d) = 1 - d / 300 s, but 1 at d = 10 s. Accuracy and
delay of a window are Corr and Delay at the shift where their sum is greatest, the least such shift.
A flat signal (standard deviation below 0.01) is scored by slopes instead. The precision of an hour
is 1 - mean |R - S| / mean |S|. The accuracy of a window that opposes the signal counts as 0; the
unclipped score counts it as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

_SAMPLE_S: Final = 10
_WINDOW: Final = 30
_LATENCY: Final = 1
_FLAT_STD: Final = 0.01
_CONSTANT_STD: Final = 1e-5

_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class HourScore:
    """Score of one hour of the clock: the mean of accuracy, delay and precision, all from 0 to 1.

    `begins` is its local time, ISO 8601; `windows` are those that were scored, at most 12.
    """

    begins: str
    windows: int
    accuracy: float
    delay: float
    precision: float
    score: float
    unclipped_score: float


@dataclass(frozen=True, slots=True)
class PerformanceScore:
    """Scores of the hours of a run, and their means, each hour weighted with its windows."""

    hours: tuple[HourScore, ...]
    accuracy: float
    delay: float
    precision: float
    score: float
    unclipped_score: float


def performance_score(
    signal: NDArray[np.float64],
    response: NDArray[np.float64],
    offered: NDArray[np.bool_],
    begins: pd.Timestamp,
    cycle_s: float,
) -> PerformanceScore | None:
    """Score a plant's response to a regulation signal, both in per unit of the capacity.

    None where there is nothing to score: a cycle is longer than 10 s, no window of 5 minutes is
    wholly within the time offered, or the signal is 0 all the time.
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
    hours = []
    hour_of_first = clock_s[first] // 3600
    for hour in np.unique(hour_of_first):
        firsts = first[hour_of_first == hour]
        score = _hour_score(signal[cycle], response[cycle], firsts)
        if score is not None:
            moment = begins + pd.Timedelta(hour * 3600 * _NS - begins_ns, unit="ns")
            hours.append(HourScore(moment.isoformat(), len(firsts), *score))
    if not hours:
        return None
    weights = [one.windows for one in hours]
    means = (
        float(np.average([getattr(one, part) for one in hours], weights=weights))
        for part in ("accuracy", "delay", "precision", "score", "unclipped_score")
    )
    return PerformanceScore(tuple(hours), *means)


def _hour_score(
    signal: NDArray[np.float64], response: NDArray[np.float64], first: NDArray[np.intp]
) -> tuple[float, float, float, float, float] | None:
    """Return what an `HourScore` has of windows that begin at these samples."""
    window = first[:, None] + np.arange(_WINDOW)
    asked = np.abs(signal[window]).mean()
    if asked == 0.0:
        return None
    # NaN beyond the end of the run: there is no response to look at.
    beyond = np.concatenate([response, np.full(_WINDOW, np.nan)])
    shifted = sliding_window_view(beyond, _WINDOW)[first[:, None] + np.arange(_WINDOW + 1)]
    accuracy, delay = window_scores(signal[window], shifted)
    precision = 1.0 - np.abs(response[window] - signal[window]).mean() / asked
    clipped = float(accuracy.clip(min=0.0).mean())
    parts = clipped, float(delay.mean()), float(np.clip(precision, 0.0, 1.0))
    score = sum(parts) / 3.0
    unclipped_score = score + (float(accuracy.mean()) - clipped) / 3.0
    return *parts, score, unclipped_score


def window_scores(
    signal: NDArray[np.float64], shifted: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Score W windows of 5 minutes for accuracy, up to 1 and not clipped at 0, and delay, 0 to 1.

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
    return accuracy.clip(max=1.0), delay


def _correlations(signal: NDArray[np.float64], shifted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pearson's r of each window and shift, shape (W, 31); 0 where either side is constant."""
    x = signal - signal.mean(axis=1, keepdims=True)
    y = shifted - shifted.mean(axis=2, keepdims=True)
    signal_std, shifted_std = signal.std(axis=1)[:, None], shifted.std(axis=2)
    # A NaN is not below anything: windows without a response stay NaN.
    moves = (signal_std > 0.0) & ~(shifted_std < _CONSTANT_STD)
    correlation: NDArray[np.float64] = np.zeros_like(shifted_std)
    covariance = np.einsum("wi,wdi->wd", x, y) / _WINDOW
    np.divide(covariance, signal_std * shifted_std, out=correlation, where=moves)
    return correlation


def _slopes(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slope of the least-squares line through each window, per sample, shape (W,)."""
    index = np.arange(_WINDOW) - (_WINDOW - 1) / 2.0
    return np.asarray(windows @ index / (index @ index))
