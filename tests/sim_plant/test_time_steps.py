"""Measurements of one time step in runs of another."""

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

from sim_plant import Floats
from sim_plant.time_steps import on_cycles

NOON = pd.Timestamp("2010-04-01T22:00:00Z")


def stamps(
    count: int, step: str, begin: pd.Timestamp = NOON, offset_s: float = 0.0
) -> pd.DatetimeIndex:
    return pd.date_range(begin + pd.Timedelta(offset_s, unit="s"), periods=count, freq=step)


def brought(values: Floats, step: str, cycles: pd.DatetimeIndex) -> Floats:
    return on_cycles(stamps(len(values), step), values, cycles, "data.csv")


TWO = np.column_stack([np.arange(12.0), 2.0 * np.arange(12.0)])


@pytest.mark.parametrize(
    ("step", "cycles", "expected"),
    [
        ("10s", stamps(4, "10s", offset_s=30.0), [3.0, 4.0, 5.0, 6.0]),
        ("1s", stamps(3, "3s", offset_s=2.0), [3.0, 6.0, 9.0]),
        ("10s", stamps(6, "5s", offset_s=20.0), [2.0, 2.5, 3.0, 3.5, 4.0, 4.5]),
        ("1s", stamps(4, "500ms", offset_s=10.0), [10.0, 10.5, 11.0, 11.0]),
        (
            "1s",
            pd.DatetimeIndex([*stamps(2, "2s"), *stamps(2, "2s", offset_s=8.0)]),
            [0.5, 2.5, 8.5, 10.5],
        ),
        ("1s", stamps(3, "1s", offset_s=4.25), [4.0, 5.0, 6.0]),
    ],
    ids=["alike", "mean", "line", "the last value holds", "hours left out", "the earlier value"],
)
def test_cycles_take_values_their_mean_or_the_line_between_them(
    step: str, cycles: pd.DatetimeIndex, expected: list[float]
) -> None:
    found = brought(TWO, step, cycles)
    np.testing.assert_allclose(found[:, 0], expected)
    np.testing.assert_allclose(found[:, 1], 2.0 * found[:, 0])


@pytest.mark.parametrize(
    ("count", "cycle", "offset_s", "message"),
    [
        (13, "1s", 0.0, "22:00:00Z to 2010-04-01T22:00:13Z"),
        (25, "500ms", 0.0, "22:00:00Z to 2010-04-01T22:00:12.500000Z"),
        (1, "1s", -1.0, "21:59:59Z to 2010-04-01T22:00:00Z"),
    ],
)
def test_measurements_too_short_are_refused(
    count: int, cycle: str, offset_s: float, message: str
) -> None:
    found = complaint_of(brought, TWO, "1s", stamps(count, cycle, offset_s=offset_s))
    assert f"2010-04-01T{message}" in found


def test_a_longer_cycle_that_is_no_multiple_is_refused() -> None:
    complaint = complaint_of(brought, TWO, "1s", stamps(2, "1500ms"))
    assert complaint.endswith("1 s, or shorter, got 1.5 s")
