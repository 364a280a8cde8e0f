"""Statistics of regulation signals, real and synthetic, as `docs/metrics.md` has them."""

from __future__ import annotations

import numpy as np

from sim_plant import Floats
from sim_plant.synthetic_regd import STEP_S

DAY = 86_400 // STEP_S
"""Values in a day."""

_LAGS_S = (10, 20, 60, 120, 300, 600, 900)
_STEP_LAGS_S = (2, 10, 20, 40, 60)
_MEANS_MIN = (5, 15, 30, 60)


def statistics(signal: Floats) -> dict[str, float]:
    """Return what is compared of a signal of a value every 2 s, of whole days."""
    steps = np.diff(signal)
    found = {
        "mean": float(signal.mean()),
        "mean of absolute values": float(np.abs(signal).mean()),
        "standard deviation": float(signal.std()),
        "share at its ends (within 1e-4), %": 100.0 * float((np.abs(signal) >= 0.9999).mean()),
        "mileage per hour": float(np.abs(steps).mean()) * 3600.0 / STEP_S,
        "largest step of a day (median of the days)": _largest_step(signal),
        "99 % of the steps are below": float(np.quantile(np.abs(steps), 0.99)),
        "kurtosis of the steps": float(((steps - steps.mean()) ** 4).mean() / steps.var() ** 2),
    }
    for minutes in _MEANS_MIN:
        means = signal.reshape(-1, minutes * 60 // STEP_S).mean(axis=1)
        found[f"standard deviation of means over {minutes} min"] = float(means.std())
    for lag_s in _LAGS_S:
        found[f"autocorrelation, {lag_s} s"] = _autocorrelation(signal, lag_s)
    for lag_s in _STEP_LAGS_S:
        found[f"autocorrelation of the steps, {lag_s} s"] = _autocorrelation(steps, lag_s)
    return found


def _largest_step(signal: Floats) -> float:
    return float(np.median(np.abs(np.diff(signal.reshape(-1, DAY))).max(axis=1)))


def _autocorrelation(series: Floats, lag_s: int) -> float:
    lag = lag_s // STEP_S
    return float(np.corrcoef(series[:-lag], series[lag:])[0, 1])


def outside(real: dict[str, float], single: list[dict[str, float]]) -> list[str]:
    """Return the statistics in which a real day lies outside the range of synthetic single days."""
    ranges = {name: [day[name] for day in single] for name in real}
    return [name for name, of in ranges.items() if not min(of) <= real[name] <= max(of)]
