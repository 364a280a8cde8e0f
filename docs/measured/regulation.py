"""The tables of docs/metrics.md: the synthetic RegD beside two days of the real one."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from regd_statistics import DAY, outside, statistics
from scipy.optimize import least_squares
from tables import Lines, Tables, header, row

from sim_plant import synthetic_regd
from sim_plant.regulation import read_signal

DAYS: Final = ("2020-07-16", "2020-07-22")
BEGINNING: Final = {
    "_NEUTRAL_S": 3000.0,
    "_PLATEAU_S": 1000.0,
    "_SLOPE": 1.0,
    "_PACE_LOG_STD": 1.0,
    "_PACE_MEMORY_S": 60.0,
    "_SMOOTH_S": 60.0,
    "_ROUGHNESS": 0.05,
    "_STD": 0.5,
}
"""The constants that are fitted, and where the fit begins."""
SHIPPED: Final = {name: getattr(synthetic_regd, name) for name in BEGINNING}
JUDGED_WITH: Final = range(5)

Days = list[dict[str, float]]


@cache
def real_day(data: Path, date: str) -> dict[str, float]:
    """Return the statistics of a day of the real signal."""
    return statistics(read_signal(data / "pjm-regd-2s" / f"regd_{date}.csv")[1][:DAY])


def synthetic_days(seed: int, constants: Mapping[str, float] = SHIPPED) -> Days:
    """Return the statistics of the 40 days of a seed, with other constants of the signal."""
    with patch.multiple(synthetic_regd, **constants):
        signal = synthetic_regd.synthetic_regd(seed)
    return [statistics(day) for day in signal.reshape(-1, DAY)]


def days(data: Path) -> Lines:
    """Write both real days beside the synthetic ones."""
    whole = statistics(synthetic_regd.synthetic_regd(0))
    single = synthetic_days(0)
    yield from header(["", *DAYS, "synthetic", "its days"])
    for name, value in whole.items():
        least, most = (pick(day[name] for day in single) for pick in (min, max))
        figures = [*(real_day(data, date)[name] for date in DAYS), value]
        yield row([name, *(f"{one:.3f}" for one in figures), f"{least:.3f} to {most:.3f}"])


def held_out(data: Path) -> Lines:
    """Fit the constants to each real day alone; write in what both are outside of 40 days."""
    yield from header(["fitted to", "seed", *(f"{date} is outside in" for date in DAYS)])
    for date in DAYS:
        constants = fitted(real_day(data, date))
        for seed in JUDGED_WITH:
            single = synthetic_days(seed, constants)
            found = [outside(real_day(data, one), single) for one in DAYS]
            yield row([date, seed, *("; ".join(names) or "nothing" for names in found)])


def fitted(real: dict[str, float]) -> dict[str, float]:
    """Fit the constants to a real day."""
    names = [name for name in real if name != "mean"]
    shipped = synthetic_days(0)
    spread = {name: np.std([day[name] for day in shipped]) for name in names}

    def constants(logarithms: NDArray[np.float64]) -> dict[str, float]:
        return dict(zip(BEGINNING, np.exp(logarithms).tolist(), strict=True))

    def apart(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
        days = synthetic_days(0, constants(logarithms))
        medians = {name: np.median([day[name] for day in days]) for name in names}
        return np.array([(medians[name] - real[name]) / spread[name] for name in names])

    beginning = np.log(list(BEGINNING.values()))
    return constants(least_squares(apart, beginning, diff_step=0.03, max_nfev=14).x)


TABLES: Final[Tables] = {
    "RegD": days,
    "RegD, held out": held_out,
}
