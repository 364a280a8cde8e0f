"""The synthetic regulation signal: the same for a seed, and alike the real one."""

from __future__ import annotations

import numpy as np
import pytest

from sim_plant import Floats
from sim_plant.synthetic_regd import SAMPLES, STEP_S, synthetic_regd

DAY = 86_400 // STEP_S
"""Values in a day."""


@pytest.fixture(scope="module")
def signal() -> Floats:
    return synthetic_regd(seed=1)


def statistics(day: Floats) -> dict[str, float]:
    steps = np.diff(day)
    quarters = day.reshape(-1, 900 // STEP_S).mean(axis=1)
    minute = 60 // STEP_S
    return {
        "mean of absolute values": float(np.abs(day).mean()),
        "share at its ends (within 1e-4), %": 100.0 * float((np.abs(day) >= 0.9999).mean()),
        "mileage per hour": float(np.abs(steps).mean()) * 3600.0 / STEP_S,
        "largest step": float(np.abs(steps).max()),
        "standard deviation of means over 15 min": float(quarters.std()),
        "autocorrelation, 60 s": float(np.corrcoef(day[:-minute], day[minute:])[0, 1]),
        "autocorrelation of the steps, 2 s": float(np.corrcoef(steps[:-1], steps[1:])[0, 1]),
    }


@pytest.fixture(scope="module")
def single_days(signal: Floats) -> list[dict[str, float]]:
    return [statistics(day) for day in signal.reshape(-1, DAY)]


def test_a_seed_gives_one_signal_and_another_seed_another(signal: Floats) -> None:
    assert signal.shape == (SAMPLES,)
    np.testing.assert_array_equal(synthetic_regd(seed=1), signal)
    other = synthetic_regd(seed=2)
    assert abs(np.corrcoef(signal, other)[0, 1]) < 0.05


# From the two days of the real signal; docs/metrics.md has them.
REAL = {
    "mean of absolute values": (0.48, 0.53),
    "share at its ends (within 1e-4), %": (13.0, 16.0),
    "mileage per hour": (24.0, 28.0),
    "largest step": (0.20, 0.26),
    "standard deviation of means over 15 min": (0.31, 0.36),
    "autocorrelation, 60 s": (0.72, 0.78),
    "autocorrelation of the steps, 2 s": (0.85, 0.93),
}


def test_the_median_day_moves_like_the_real_ones(single_days: list[dict[str, float]]) -> None:
    for name, (least, most) in REAL.items():
        assert least <= np.median([day[name] for day in single_days]) <= most, name


def test_the_signal_is_energy_neutral(signal: Floats) -> None:
    # Parts of a day make up for each other; a whole day has an offset of its own.
    of_parts = signal.reshape(40, -1, DAY // 6).mean(axis=2)
    of_days = of_parts.mean(axis=1)
    # Independent quarters of an hour would give 0.337 / sqrt(16) = 0.084.
    assert (of_parts - of_days[:, None]).std() < 0.06
    assert 0.02 < of_days.std() < 0.05
    assert abs(signal.mean()) < 0.01
