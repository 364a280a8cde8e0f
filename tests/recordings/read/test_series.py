"""A series has a row for each cycle by its number, whatever is missing or came twice."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Production
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, SeriesCollector, series_of
from results.figures import run_figures

CYCLES = 30


def recorded(path: Path, is_kept: Callable[[Delivery], bool] = lambda pair: True) -> RunSeries:
    write_run(path / "run.mcap", whole_run(CYCLES), is_kept=is_kept)
    with RunReader(path) as reader:
        return series_of(reader)


@pytest.mark.parametrize("lacking", ["production", "dispatch"])
def test_a_missing_message_leaves_its_row_empty(tmp_path: Path, lacking: str) -> None:
    series = recorded(tmp_path, lambda pair: (pair[0].signal.name, pair[1].cycle) != (lacking, 7))
    assert series.cycles == CYCLES
    assert list(np.flatnonzero(~series.known)) == [7]
    assert series.times[7].second == 7
    assert np.isnan(series.delivered_kw[7]) == (lacking == "production")
    assert np.isnan(series.dispatch_kw[7]) == (lacking == "dispatch")
    figures = run_figures(series)
    assert figures["dispatched-energy"] == pytest.approx(240.0 * (CYCLES - 1) / 3600)
    assert (figures["cycles"], figures["planned-cycles"]) == (CYCLES - 1, PLAN.timing.cycles)


def test_a_series_ends_with_the_last_completed_cycle(tmp_path: Path) -> None:
    series = recorded(
        tmp_path, lambda pair: pair[0].signal.name != "production" or pair[1].cycle < 20
    )
    assert series.cycles == 20
    assert series.known.all()


@pytest.mark.parametrize("lacking", ["production", "dispatch"])
def test_without_a_completed_cycle_there_is_no_series(tmp_path: Path, lacking: str) -> None:
    with pytest.raises(InputError, match=str(tmp_path)):
        recorded(tmp_path, lambda pair: pair[0].signal.name != lacking)


def test_of_several_messages_in_a_cycle_the_first_one_counts() -> None:
    once, twice = SeriesCollector(PLAN), SeriesCollector(PLAN)
    for port, message in whole_run(CYCLES):
        once.see(port, message)
        twice.see(port, message)
        if port.signal.name == "impp":
            message.power_kw += 7.0  # type: ignore[attr-defined]
            twice.see(port, message)
    assert np.array_equal(once.series("").impp_kw, twice.series("").impp_kw)


def test_a_cycle_in_which_dispatches_contradict_each_other_does_not_count() -> None:
    collector = SeriesCollector(PLAN)
    for port, message in whole_run(CYCLES):
        said = [message]
        if isinstance(message, Dispatch) and message.cycle in {0, 7, 8}:
            said = [message, replace(message, commitment_kw=400.0), message]
        for one in said:
            collector.see(port, one)
    series = collector.series("")
    assert list(np.flatnonzero(~series.known)) == [0, 7, 8]
    assert set(series.commitment_kw[series.known]) == {230.0}


def test_in_a_large_plant_clusters_stand_for_their_inverters(tmp_path: Path) -> None:
    whole = recorded(tmp_path)
    with RunReader(tmp_path) as reader:
        found = series_of(reader, 3)
        assert series_of(reader, 4).inverters == whole.inverters
    assert (found.inverters, found.noun) == (("c1", "c2"), "cluster")
    assert np.array_equal(found.delivered_kw, whole.delivered_kw)
    assert set(found.residual_kw[:, 0]) == {15.0}, "of the supervisor c1"


@pytest.mark.parametrize(("meter", "delivered_kw"), [("", 239.0), ("modbus://10.0.0.9", 230.0)])
def test_statements_of_the_plant_on_meter_and_lost_inverters_count(
    meter: str, delivered_kw: float
) -> None:
    collector = SeriesCollector(with_changes(PLAN, meter=meter))
    for port, message in whole_run(CYCLES):
        if isinstance(message, Production):
            message.delivered_kw, message.unknown_kw = 230.0, 15.0
        collector.see(port, message)
    series = collector.series("")
    assert set(series.delivered_kw) == {delivered_kw}
    assert run_figures(series)["unknown-energy"] == pytest.approx(15.0 * CYCLES / 3600)
