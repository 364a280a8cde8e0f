"""Runs on archives and on a real plant's currents: the plant they make, and what is said of it."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from oahu_days import day_text
from own_scenarios import Folder

from scenarios.scenario import load_scenario

AP3 = 12
"""Place of AP3 among the 19 sensors of a line."""


def write_day(folder: Path, day: date, ghi_wm2: NDArray[np.float64]) -> None:
    (folder / f"{day:%Y%m%d}.txt").write_text(day_text(day, ghi_wm2))


def clouds(seed: int) -> NDArray[np.float64]:
    """Two minutes of 19 sensors that differ from one another from second to second."""
    return np.random.default_rng(seed).uniform(200.0, 1000.0, (120, 19))


# Daily files of the Oahu grid ---------------------------------------------------------------------


@pytest.fixture
def oahu(tmp_path: Path) -> Folder:
    data = tmp_path / "archive"
    data.mkdir()
    write_day(data, date(2010, 3, 30), clouds(1))
    write_day(data, date(2010, 4, 1), clouds(2))
    copy = Folder(tmp_path, load_scenario("oahu-grid").text, data)
    copy.change("start = 2010-04-01T05:00:00", "start = 2010-04-01T12:00:00")
    copy.change("duration_s = 54000", "duration_s = 120")
    return copy


def test_the_17_sensors_become_17_inverters_in_clusters_of_6_6_and_5(oahu: Folder) -> None:
    found = oahu.prepare()
    tree = found.plan.tree
    assert found.profile.mpp_kw.shape == (120, 17)
    assert tree.rating_kw("") == pytest.approx(8000.0)
    assert [len(tree.children(parent)) for parent in ("c1", "c2", "c3")] == [6, 6, 5]
    assert {leaf.rpartition("/")[2] for leaf in tree.leaves} >= {"invDH1", "invAP3", "invAP7"}
    (commitment,) = found.remarks
    assert "hindsight" in commitment, "not so the clusters"


def test_a_sensor_left_out_takes_its_inverter_and_rating_away(oahu: Folder, tmp_path: Path) -> None:
    ghi_wm2 = clouds(2)
    ghi_wm2[:40, AP3] = np.nan
    write_day(tmp_path / "archive", date(2010, 4, 1), ghi_wm2)
    found = oahu.prepare()
    assert "invAP3" not in {leaf.rpartition("/")[2] for leaf in found.plan.tree.leaves}
    assert found.plan.tree.rating_kw("") == pytest.approx(8000.0 * 16 / 17)
    assert found.remarks[0].startswith("20100401.txt: AP3: 40 of 120 values missing")


def test_clusters_are_those_of_the_earlier_day_whose_gaps_are_told(
    oahu: Folder, tmp_path: Path
) -> None:
    leaves = oahu.prepare().plan.tree.leaves
    write_day(tmp_path / "archive", date(2010, 4, 1), clouds(3))
    assert oahu.prepare().plan.tree.leaves == leaves
    earlier = clouds(4)
    earlier[5, AP3] = np.nan
    write_day(tmp_path / "archive", date(2010, 3, 31), earlier)
    found = oahu.prepare()
    assert found.plan.tree.leaves != leaves
    assert found.remarks[0].startswith("20100331.txt: AP3: 1 of 120 values missing")


def test_a_day_shorter_than_the_run_and_a_folder_without_days_are_refused(
    oahu: Folder, tmp_path: Path
) -> None:
    assert "2010-04-01T22:02:01Z" in oahu.complaint(duration="121s")
    (tmp_path / "archive" / "20100330.txt").unlink()
    assert "of a day before 2010-04-01" in oahu.complaint()
    oahu.change('"earlier-day"', '"hindsight"')
    assert "neighbours" in str(oahu.prepare().remarks), "that needs no earlier day"
    (tmp_path / "archive" / "20100401.txt").unlink()
    assert ": irradiance.folder: expected" in oahu.complaint()


# Currents of a real plant -------------------------------------------------------------------------


def write_plant(folder: Path, silent: str = "") -> None:
    """Write ten minutes of six inverters with two combiners each, 100 being full power."""
    names = [(f"C-{i}-{c}", f"{i:02d}", 50 * i, 10 * c) for i in range(6) for c in (1, 2)]
    positions = pd.DataFrame(names, columns=["combiner", "inverter", "x_m", "y_m"])
    positions.to_csv(folder / "positions.csv", index=False)
    currents = np.random.default_rng(8).uniform(20.0, 120.0, (60, 12)).round(3)
    currents[:, positions["inverter"] == silent] = np.nan
    table = pd.DataFrame(currents, pd.RangeIndex(0, 600, 10, name="t_s"), positions["combiner"])
    table.to_csv(folder / "hour_a.csv")


@pytest.fixture
def plant(tmp_path: Path) -> Folder:
    data = tmp_path / "plant"
    data.mkdir()
    write_plant(data)
    copy = Folder(tmp_path, load_scenario("plant20mw").text, data)
    copy.change("duration_s = 3600", "duration_s = 600")
    copy.change("cluster_count = [5]", "cluster_count = [2]")
    return copy


def test_power_comes_from_the_currents(plant: Folder, tmp_path: Path) -> None:
    found = plant.prepare()
    assert found.plan.tree.rating_kw("") == pytest.approx(20_000.0)
    assert found.profile.mpp_kw.shape == (60, 6)
    currents = pd.read_csv(tmp_path / "plant" / "hour_a.csv")
    place = [leaf.rpartition("/")[2] for leaf in found.plan.tree.leaves].index("inv04")
    mean = currents[["C-4-1", "C-4-2"]].mean(axis=1).to_numpy()
    expected_kw = np.minimum(mean / 130.0, 1.0) * 20_000.0 / 6
    np.testing.assert_allclose(found.profile.mpp_kw[:, place], expected_kw)


def test_a_silent_inverter_takes_its_rating_away_and_neighbours_share_a_cluster(
    plant: Folder, tmp_path: Path
) -> None:
    plant.change('clusters = "correlation"', 'clusters = "geographic"')
    leaves = plant.prepare().plan.tree.leaves
    assert set(leaves) == {f"c{1 + i // 3}/inv0{i}" for i in range(6)}
    write_plant(tmp_path / "plant", silent="02")
    found = plant.prepare()
    assert found.plan.tree.rating_kw("") == pytest.approx(20_000.0 * 5 / 6)
    assert [len(found.plan.tree.children(parent)) for parent in ("c1", "c2")] == [3, 2]
    assert found.remarks[0].startswith("hour_a.csv: inverter 02: 120 of 120 currents")


@pytest.mark.parametrize("commitment", ['"share-of-clear-sky"\nshare = 0.7', '"offered"'])
def test_currents_have_a_clear_sky_where_the_place_of_the_plant_is_known(
    plant: Folder, commitment: str
) -> None:
    plant.change('"share-of-median"\nshare = 0.7', commitment)
    assert "irradiance.lat, lon: expected" in plant.complaint()
    plant.change("full_power_current = 130", "full_power_current = 130\nlat = 40.0\nlon = -4.0")
    found = plant.prepare()
    assert found.plan.tree.rating_kw("") > found.profile.commitment_kw.min() > 0.0
