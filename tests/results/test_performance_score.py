"""PJM's performance score: by hand, and beside a calculation window by window."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from results.regulation import performance_score, window_scores

NOON = pd.Timestamp("2010-04-01T12:00:00", tz="Pacific/Honolulu")
HOUR = 3600


def random_signal(seconds: int, seed: int = 1) -> NDArray[np.float64]:
    """Return a signal of a value every 10 s, drawn anew each time, held in cycles of 1 s."""
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, -(-seconds // 10))
    return np.repeat(values, 10)[:seconds]


def score_of(
    signal: NDArray[np.float64],
    response: NDArray[np.float64],
    begins: pd.Timestamp = NOON,
    cycle_s: float = 1.0,
) -> dict[str, float]:
    offered = np.ones(len(signal), dtype=bool)
    found = performance_score(signal, response, offered, begins, cycle_s)
    assert found is not None
    return found


@pytest.mark.parametrize(("late_s", "delay"), [(0, 1.0), (10, 1.0), (20, 1 - 20 / 300), (150, 0.5)])
def test_a_late_response_costs_delay_beyond_the_10_s_that_the_signal_may_travel(
    late_s: int, delay: float
) -> None:
    # One window of 5 minutes, and 5 more minutes in which its response may come.
    signal = random_signal(600)
    response = np.concatenate([np.zeros(late_s), signal[: 600 - late_s]])
    offered = np.arange(600) < 300
    found = performance_score(signal, response, offered, NOON, 1.0)
    assert found is not None
    assert (found["accuracy"], found["delay"]) == pytest.approx((1.0, delay))
    error = np.abs(response[:300:10] - signal[:300:10]).mean()
    assert found["precision"] == pytest.approx(
        max(0.0, 1.0 - error / np.abs(signal[:300:10]).mean())
    )


def test_hours_are_those_of_the_clock_and_weigh_as_many_windows_as_they_have() -> None:
    # 12:43 to 13:22: three windows from 12:45 to 13:00, four from 13:00 to 13:20
    begins = NOON + pd.Timedelta(minutes=43)
    signal = random_signal(39 * 60)
    good = np.arange(len(signal)) < 17 * 60
    found = score_of(signal, np.where(good, signal, 0.5 * signal), begins)
    assert found["precision"] == pytest.approx((3 * 1.0 + 4 * 0.5) / 7)


@pytest.mark.parametrize(
    ("seconds", "cycle_s"), [(290, 1.0), (HOUR, 20.0)], ids=["too short", "cycle too long"]
)
def test_where_there_is_nothing_to_score_there_is_no_score(seconds: int, cycle_s: float) -> None:
    signal = random_signal(seconds)
    assert performance_score(signal, signal, np.ones(seconds, bool), NOON, cycle_s) is None


def test_scores_of_windows_are_those_of_a_calculation_one_by_one() -> None:
    generator = np.random.default_rng(7)
    signal = generator.uniform(-1.0, 1.0, (12, 30))
    signal[3] = 0.25
    response = generator.uniform(-1.0, 1.0, 12 * 30 + 30)
    response[100:180] = 0.5
    response[-30:] = np.nan
    shifted = np.array(
        [[response[30 * w + d : 30 * w + d + 30] for d in range(31)] for w in range(12)]
    )
    accuracy, delay = window_scores(signal, shifted)
    for window in range(12):
        found, promptness = _one_by_one(signal[window], shifted[window])
        assert (accuracy[window], delay[window]) == pytest.approx((max(found, 0.0), promptness))


def _one_by_one(signal: NDArray[np.float64], shifted: NDArray[np.float64]) -> tuple[float, float]:
    if np.std(signal) < 0.01:
        slopes = [np.polyfit(np.arange(30), series, 1)[0] for series in (signal, shifted[0])]
        return 1.0 - abs(slopes[0] - slopes[1]), 1.0
    best, found = -np.inf, (0.0, 0.0)
    if all(np.ptp(response) == 0.0 for response in shifted):
        return found
    for shift in range(31):
        response = shifted[shift]
        if np.isnan(response).any():
            continue
        correlation = 0.0 if np.ptp(response) == 0.0 else np.corrcoef(signal, response)[0, 1]
        delay = 1.0 if shift <= 1 else abs(10 * shift - 300) / 300
        if correlation + delay > best:
            best, found = correlation + delay, (correlation, delay)
    return found
