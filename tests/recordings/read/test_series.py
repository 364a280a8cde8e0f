"""A series has a row for each cycle by its number, whatever is missing or came twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries, SeriesCollector, read_plant_series, read_series
from results.metrics import run_metrics

CYCLES = 30


def series_of(path: Path, is_kept: Callable[[Delivery], bool]) -> RunSeries:
    write_run(path / "run.mcap", whole_run(CYCLES), is_kept=is_kept)
    return read_series(path)


@pytest.mark.parametrize("lacking", ["production", "dispatch"])
def test_a_missing_message_leaves_its_row_empty(tmp_path: Path, lacking: str) -> None:
    series = series_of(tmp_path, lambda pair: (pair[0].signal.name, pair[1].cycle) != (lacking, 7))
    assert series.cycles == CYCLES
    assert list(np.flatnonzero(~series.known)) == [7]
    assert series.times[7].second == 7
    assert np.isnan(series.delivered_kw[7]) == (lacking == "production")
    assert np.isnan(series.dispatch_kw[7]) == (lacking == "dispatch")
    metrics = run_metrics(series)
    assert metrics.commitment.dispatched_kwh == pytest.approx(240.0 * (CYCLES - 1) / 3600)


def test_a_series_ends_with_the_last_completed_cycle(tmp_path: Path) -> None:
    series = series_of(
        tmp_path, lambda pair: pair[0].signal.name != "production" or pair[1].cycle < 20
    )
    assert series.cycles == 20
    assert series.known.all()


@pytest.mark.parametrize("lacking", ["production", "dispatch"])
def test_without_a_completed_cycle_there_is_no_series(tmp_path: Path, lacking: str) -> None:
    with pytest.raises(InputError, match=str(tmp_path)):
        series_of(tmp_path, lambda pair: pair[0].signal.name != lacking)


def test_of_several_messages_in_a_cycle_the_first_one_counts() -> None:
    once, twice = SeriesCollector(PLAN), SeriesCollector(PLAN)
    for port, message in whole_run(CYCLES):
        once.see(port, message)
        twice.see(port, message)
        if port.signal.name == "impp":
            message.power_kw += 7.0  # type: ignore[attr-defined]
            twice.see(port, message)
    assert np.array_equal(once.series("").impp_kw, twice.series("").impp_kw)


def test_figures_of_merit_of_the_plant_are_the_same_without_the_controllers_messages(
    tmp_path: Path,
) -> None:
    whole = run_metrics(series_of(tmp_path, lambda pair: True))
    assert run_metrics(read_plant_series(tmp_path)) == replace(whole, help=None)
