"""Statistics of regulation signals, real beside synthetic, as `docs/metrics.md` has them.

.venv/bin/python tests/sim_plant/regd_statistics.py regd_2020-07-16.csv regd_2020-07-22.csv
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim_plant.regulation import read_signal
from sim_plant.synthetic_regd import STEP_S, synthetic_regd

DAY = 86_400 // STEP_S
"""Values in a day."""

_LAGS_S = (10, 20, 60, 120, 300, 600, 900)
_STEP_LAGS_S = (2, 10, 20, 40, 60)
_MEANS_MIN = (5, 15, 30, 60)


def statistics(signal: NDArray[np.float64]) -> dict[str, float]:
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


def _largest_step(signal: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(np.diff(signal.reshape(-1, DAY))).max(axis=1)))


def _autocorrelation(series: NDArray[np.float64], lag_s: int) -> float:
    lag = lag_s // STEP_S
    return float(np.corrcoef(series[:-lag], series[lag:])[0, 1])


def outside(
    real: dict[str, float], single: list[dict[str, float]], centre: dict[str, float] | None = None
) -> list[str]:
    """Return the statistics in which a real day lies outside the range of synthetic single days.

    With a `centre`, another real day, the range of each statistic is moved so that its median is
    the value of that day: then only the spread of the synthetic days is judged. What grows with the
    signal or its steps is moved by a factor.
    """
    names = []
    for name, value in real.items():
        of_days = np.array([day[name] for day in single])
        if centre is not None:
            if name == "mean" or name.startswith("autocorrelation"):
                of_days += centre[name] - np.median(of_days)
            else:
                of_days *= centre[name] / np.median(of_days)
        if not of_days.min() <= value <= of_days.max():
            names.append(name)
    return names


def main(paths: list[str]) -> None:
    """Print real days beside 40 synthetic ones, and what of each day is outside their range."""
    days = [statistics(read_signal(Path(path)).value[:DAY]) for path in paths]
    synthetic = synthetic_regd(0)
    whole = statistics(synthetic)
    single = [statistics(day) for day in synthetic.reshape(-1, DAY)]
    print(_row([" ", *(Path(path).stem for path in paths), "synthetic", "its days"]))
    print("|---" * (len(paths) + 3) + "|")
    for name, value in whole.items():
        least, most = (pick(day[name] for day in single) for pick in (min, max))
        figures = [f"{day[name]:.3f}" for day in days]
        print(_row([name, *figures, f"{value:.3f}", f"{least:.3f} to {most:.3f}"]))
    for path, day in zip(paths, days, strict=True):
        print(f"\n{Path(path).stem} is outside in: {outside(day, single) or 'nothing'}")
        for other_path, other in zip(paths, days, strict=True):
            if other is not day:
                names = outside(day, single, centre=other)
                print(f"with the range centred on {Path(other_path).stem}: {names or 'nothing'}")


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main(sys.argv[1:])
