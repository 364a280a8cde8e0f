"""The grid's frequency, cycle by cycle."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from complaints import complaint_of

from sim_plant.frequency import (
    FrequencyEvent,
    FrequencyEvents,
    FrequencyFile,
    FrequencySettings,
    frequency_hz,
)

BEGINS = pd.Timestamp("2024-06-15 12:00", tz="Europe/Berlin")


def seen(settings: FrequencySettings | None, cycles: int, cycle_s: float = 1.0) -> list[float]:
    found, _ = frequency_hz(settings, cycles, cycle_s, 50.0, Path, BEGINS)
    return [round(float(hz), 9) for hz in found]


def test_an_event_goes_to_its_depth_at_its_rate_and_returns_at_the_same_rate() -> None:
    event = FrequencyEvent(at=2.0, depth_hz=-0.3, rate_hz_per_s=0.1, duration_s=5.0)
    expected = [50.0, 50.0, 50.0, 49.9, 49.8, 49.7, 49.7, 49.7, 49.8, 49.9, 50.0, 50.0]
    assert seen(FrequencyEvents(events=(event,)), 12) == expected
    assert seen(None, 3) == [50.0] * 3
    # One that is over before it has come to its depth returns from where it is.
    short = FrequencyEvent(at=0.0, depth_hz=1.0, rate_hz_per_s=0.1, duration_s=2.0)
    assert seen(FrequencyEvents(events=(short,)), 6) == [50.0, 50.1, 50.2, 50.1, 50.0, 50.0]


def test_each_value_of_a_file_holds_until_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "frequency.csv"
    path.write_text("s,hz\n0,50\n2,49.9\n4,50.1\n")
    settings = FrequencyFile(path=str(path))
    assert seen(settings, 6) == [50.0, 50.0, 49.9, 49.9, 50.1, 50.1]
    assert "frequency.csv" in complaint_of(seen, settings, 7)
    path.write_text("s,hz\n0,50\n2,5\n4,50.1\n")
    assert "from 10 to 110" in complaint_of(seen, settings, 4)
