"""Missing values of a sensor, filled from the sensors around it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

from sim_plant import Floats
from sim_plant.gap_filling import fill_from_neighbours
from sim_plant.irradiance import Irradiance, read_measured_ghi

NAN = np.nan


def line_of_sensors(ghi_wm2: Floats, north_m: list[float]) -> Irradiance:
    """Sensors A, B, C ... on a meridian."""
    names = list("ABCDEFGH"[: len(north_m)])
    times = pd.date_range("2010-04-01T20:00:00Z", periods=len(ghi_wm2), freq="1s")
    lat_deg = 21.3 + np.array(north_m) / 111_200.0
    coordinates = pd.DataFrame({"lat": lat_deg, "lon": -158.0}, names)
    return Irradiance(pd.DataFrame(ghi_wm2, times, names), coordinates, "day.txt")


def filled(ghi_wm2: Floats, north_m: list[float]) -> Floats:
    found = fill_from_neighbours(line_of_sensors(ghi_wm2, north_m))
    return np.asarray(found.ghi_wm2, dtype=np.float64)


def test_weights_are_inverse_squares_of_distances_and_the_sensors_own_level_is_kept() -> None:
    # B is 100 m away and C 200 m: weights 4 and 1. A reads a tenth less whenever all are there.
    given = line_of_sensors(
        np.array([[90.0, 100.0, 100.0], [NAN, 500.0, 1000.0], [270.0, 300.0, 300.0]]),
        [0.0, 100.0, -200.0],
    )
    found = fill_from_neighbours(given)
    assert found.ghi_wm2["A"].iloc[1] == pytest.approx(0.9 * (4 * 500.0 + 1000.0) / 5, rel=1e-9)
    (line,) = found.report
    assert line.startswith("A: 1 of 3 values missing")
    assert line.endswith("times 0.900")


def test_values_that_are_there_stay_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    ghi_wm2 = 1000.0 * rng.random((200, 4))
    ghi_wm2[rng.random(ghi_wm2.shape) < 0.2] = NAN
    ghi_wm2[:, 3] = 400.0
    given, there = ghi_wm2.copy(), ~np.isnan(ghi_wm2)
    found = filled(given, [0.0, 50.0, 120.0, 300.0])
    np.testing.assert_array_equal(found[there], ghi_wm2[there])
    assert np.isfinite(found).all()
    assert found.min() >= 0.0
    np.testing.assert_array_equal(given, ghi_wm2)


def test_where_no_sensor_has_a_value_each_draws_a_line_in_time() -> None:
    ghi_wm2 = np.array([[100.0, 10.0], [NAN, NAN], [NAN, NAN], [400.0, 40.0]])
    found = fill_from_neighbours(line_of_sensors(ghi_wm2, [0.0, 1.0]))
    np.testing.assert_allclose(found.ghi_wm2, [[100, 10], [200, 20], [300, 30], [400, 40]])
    (line,) = found.report
    assert line.startswith("all sensors: 2 of 4 values missing")


@pytest.mark.parametrize(("first", "after", "line"), [(10, 71, 71), (0, 2, 1), (98, 100, 99)])
def test_a_silence_too_long_or_at_an_end_is_refused(first: int, after: int, line: int) -> None:
    ghi_wm2 = np.full((100, 2), 500.0)
    ghi_wm2[10:70] = NAN  # Sixty values are not too long.
    assert filled(ghi_wm2, [0.0, 100.0]).min() == 500.0
    ghi_wm2[first:after] = NAN
    found = complaint_of(filled, ghi_wm2, [0.0, 100.0])
    assert found.startswith(f"day.txt: line {line}: expected at most 60 lines")


STATIONS = [str(n) for n in (16, 40, 49, 51, 53, 56, 60, 63, 65, 68, 69, 79, 81, 85, 88, 92, 100)]


def test_twenty_minutes_of_broken_clouds_come_back_well(data_folder: Path) -> None:
    folder = data_folder / "hope-melpitz-1s"
    whole = read_measured_ghi(
        folder / "ghi_20130908_0915_0955.csv", folder / "positions.csv", STATIONS
    )
    gap = whole.times[600:1800]
    rmse_wm2, of_a_line_wm2, spread = [], [], []
    for sensor in STATIONS:
        truth = whole.ghi_wm2.loc[gap, sensor]
        ghi_wm2 = whole.ghi_wm2.copy()
        ghi_wm2.loc[gap, sensor] = NAN
        line = ghi_wm2[sensor].interpolate()[gap]
        found = fill_from_neighbours(replace(whole, ghi_wm2=ghi_wm2)).ghi_wm2.loc[gap, sensor]
        rmse_wm2.append(np.sqrt(np.mean((found - truth) ** 2)))
        of_a_line_wm2.append(np.sqrt(np.mean((line - truth) ** 2)))
        spread.append(found.std() / truth.std())
    assert np.median(rmse_wm2) < np.median(of_a_line_wm2) / 3.0
    assert 0.9 < np.median(spread) < 1.1
