"""The commitment of the plant, and how its settings are written."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

from sim_plant import Floats
from sim_plant.commitment import (
    BelowAvailable,
    CommitmentSettings,
    ConstantCommitment,
    ScheduledCommitment,
    ShareOfClearSky,
    ShareOfMedian,
    commitment_kw,
)

POSSIBLE_KW = np.array([0.0, 100.0, 400.0, 300.0, 200.0])
CLEAR_SKY_KW = np.array([0.0, 200.0, 400.0, 400.0, 200.0])
NOON = pd.Timestamp("2010-04-01T12:00:00-10:00")


def cycles(count: int, freq: str = "1s", begin: pd.Timestamp = NOON) -> pd.DatetimeIndex:
    return pd.date_range(begin, periods=count, freq=freq)


def committed(
    settings: CommitmentSettings,
    available_kw: Floats = POSSIBLE_KW,
    times: pd.DatetimeIndex | None = None,
    folder: Path | None = None,
) -> Floats:
    return commitment_kw(
        settings,
        cycles(len(available_kw)) if times is None else times,
        available_kw,
        lambda times: CLEAR_SKY_KW,
        lambda name: (folder or Path()) / name,
    )


@pytest.mark.parametrize(
    ("settings", "expected_kw"),
    [
        (ConstantCommitment(power_kw=120.5), [120.5] * 5),
        (ShareOfMedian(share=0.8), [160.0] * 5),
        (ShareOfClearSky(share=0.5), [0.0, 100.0, 200.0, 200.0, 100.0]),
        (
            BelowAvailable(share=0.5, window_s=3.0),
            [25.0, 250.0 / 3, 400.0 / 3, 150.0, 125.0],
        ),
        (BelowAvailable(share=1.0, window_s=3600.0), [200.0] * 5),
    ],
)
def test_each_rule_gives_a_power_for_each_cycle(
    settings: CommitmentSettings, expected_kw: list[float]
) -> None:
    np.testing.assert_allclose(committed(settings), expected_kw)


def test_a_share_of_a_run_at_night_is_refused() -> None:
    found = complaint_of(committed, ShareOfMedian(share=0.8), np.zeros(5))
    assert found.startswith("commitment: expected")


# Schedules ----------------------------------------------------------------------------------------

SCHEDULE = """\
begins,note,commitment_kw
2010-04-01T11:00:00-10:00,bid,1000
2010-04-01T22:00:02Z,bid,2000
2010-04-01T12:00:04-10:00,bid,1500.5
"""


def scheduled(folder: Path, text: str = SCHEDULE, times: pd.DatetimeIndex | None = None) -> Floats:
    (folder / "bids.csv").write_text(text)
    settings = ScheduledCommitment(path="bids.csv")
    return committed(settings, times=cycles(5) if times is None else times, folder=folder)


def test_a_schedule_holds_from_one_time_stamp_to_the_next(tmp_path: Path) -> None:
    np.testing.assert_array_equal(scheduled(tmp_path), [1000.0, 1000.0, 2000.0, 2000.0, 1500.5])


def test_all_times_out_of_order_are_told_at_once(tmp_path: Path) -> None:
    times = ("02", "01", "03", "03")
    rows = [f"2010-04-01T22:00:{second}Z,1000" for second in times]
    text = "\n".join(["begins,commitment_kw", *rows])
    assert "all such lines: 3, 5" in complaint_of(scheduled, tmp_path, text)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("2000\n", "-2000\n", "bids.csv: line 3, column 'commitment_kw'"),
        ("22:00:02Z", "20:00:00Z", "bids.csv: line 3, column 'begins'"),
        (SCHEDULE, SCHEDULE.splitlines()[0], "bids.csv: line 1: expected a header, then values"),
    ],
)
def test_one_wrong_field_is_located(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    assert SCHEDULE.count(old) == 1
    assert complaint_of(scheduled, tmp_path, SCHEDULE.replace(old, new)).startswith(complaint)
