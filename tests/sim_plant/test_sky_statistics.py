"""Statistics of a sky: on patterns whose answer is known, and on a plant whose clouds are."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from sky_statistics import (
    SkyShares,
    changes,
    cloud_cover,
    cloud_motion,
    exceedance,
    index_by_quantile,
    lagged_correlations,
    pair_correlations,
    peak_lags,
    rotated,
    sky_shares,
)

RNG = np.random.default_rng(5)
EAST_M, NORTH_M = 1000.0 * RNG.random((2, 15))


def waves(
    speed_ms: float, from_deg: float, step_s: float = 1.0, count: int = 1200
) -> NDArray[np.float64]:
    """Sum 200 plane waves of random direction that all move with one velocity, shape (T, N)."""
    rng = np.random.default_rng(3)
    wave_number = 2.0 * np.pi / rng.uniform(300.0, 1500.0, 200)
    direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 200))
    k_east, k_north = wave_number * np.cos(direction), wave_number * np.sin(direction)
    towards = np.deg2rad(from_deg + 180.0)
    v_east, v_north = speed_ms * np.sin(towards), speed_ms * np.cos(towards)
    time_s = step_s * np.arange(count)
    at_place = np.outer(EAST_M, k_east) + np.outer(NORTH_M, k_north) + phase
    moving = np.outer(time_s, k_east * v_east + k_north * v_north)
    return np.asarray(np.cos(at_place[None] - moving[:, None]).mean(axis=2))


@pytest.mark.parametrize(("speed_ms", "from_deg"), [(5.0, 65.0), (15.0, 0.0), (15.0, 290.0)])
def test_the_motion_of_a_drifting_pattern_is_found(speed_ms: float, from_deg: float) -> None:
    motion = cloud_motion(waves(speed_ms, from_deg), EAST_M, NORTH_M, 1.0)
    assert motion.speed_ms == pytest.approx(speed_ms, rel=0.05)
    off_deg = (motion.from_deg - from_deg + 180.0) % 360.0 - 180.0
    # A few kilometres of sky are not quite alike in all directions.
    assert abs(off_deg) < 10.0
    assert motion.pairs > 15


def test_the_motion_is_found_between_the_steps_of_a_coarse_clock() -> None:
    motion = cloud_motion(waves(12.0, 100.0, step_s=10.0, count=600), EAST_M, NORTH_M, 10.0)
    assert motion.speed_ms == pytest.approx(12.0, rel=0.05)
    assert motion.from_deg == pytest.approx(100.0, abs=10.0)


@pytest.mark.parametrize(("hour", "speed_ms", "angle_rad"), [("a", 10.7, 3.29), ("c", 3.14, 1.92)])
def test_the_motion_over_a_real_plant_is_the_one_that_its_publisher_found(
    data_folder: Path, hour: str, speed_ms: float, angle_rad: float
) -> None:
    folder = data_folder / "plant20mw-combiners-10s"
    currents = pd.read_csv(folder / f"hour_{hour}.csv", index_col="t_s")
    places = pd.read_csv(folder / "positions.csv", dtype=str).set_index("combiner")
    inverters = places.loc[currents.columns, "inverter"].to_numpy()
    averaging = (inverters[:, None] == np.unique(inverters)).astype(np.float64)
    averaging /= averaging.sum(axis=0)
    metres = places.loc[currents.columns, ["x_m", "y_m"]].to_numpy(dtype=np.float64)
    east_m, north_m = metres.T @ averaging
    motion = cloud_motion(currents.to_numpy(dtype=np.float64) @ averaging, east_m, north_m, 10.0)
    # The angle is that of the velocity, counter-clockwise from east.
    from_deg = (270.0 - np.rad2deg(angle_rad)) % 360.0
    assert motion.speed_ms == pytest.approx(speed_ms, rel=0.1)
    assert motion.from_deg == pytest.approx(from_deg, abs=5.0)


def test_pair_correlations_are_pearsons_and_a_dead_sensor_has_none() -> None:
    series = np.random.default_rng(2).random((50, 4))
    series[:, 3] = 0.7
    pairs = pair_correlations(
        series, np.array([0.0, 3.0, 0.0, 9.0]), np.array([0.0, 4.0, 1.0, 9.0])
    )
    expected = np.asarray(np.corrcoef(series[:, :3].T))
    np.testing.assert_allclose(pairs.correlation[[0, 1, 3]], expected[[0, 0, 1], [1, 2, 2]])
    assert np.isnan(pairs.correlation[[2, 4, 5]]).all()
    np.testing.assert_allclose(pairs.distance_m[:2], [5.0, 1.0])
    by_class = pairs.by_distance(np.array([0.0, 2.0, 6.0, 8.0]))
    assert by_class[0] == pytest.approx(expected[0, 2])
    assert by_class[1] == pytest.approx(0.5 * (expected[0, 1] + expected[1, 2]))
    assert np.isnan(by_class[2])


def test_pairs_along_a_direction_lie_within_thirty_degrees_of_it() -> None:
    # From the first sensor: to the north, 25 and 35 degrees off, and to the south-west.
    angle = np.deg2rad([0.0, 25.0, 35.0, 225.0])
    east_m, north_m = np.append(0.0, np.sin(angle)), np.append(0.0, np.cos(angle))
    pairs = pair_correlations(np.random.default_rng(2).random((9, 5)), east_m, north_m)
    north_wind = pairs.within(180.0)
    first = np.isin(north_wind.correlation, pairs.correlation[:4])
    np.testing.assert_allclose(north_wind.north_m[first], np.cos(angle[:2]))
    west_wind = pairs.within(90.0)
    assert not np.isin(pairs.correlation[:4], west_wind.correlation).any()


def test_a_direction_is_clockwise_from_north_and_left_is_across() -> None:
    along_m, across_m = rotated(np.array([2.0, 0.0]), np.array([0.0, 3.0]), 90.0)
    np.testing.assert_allclose(along_m, [2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(across_m, [0.0, 3.0], atol=1e-12)


def test_a_delayed_copy_is_most_alike_at_its_delay() -> None:
    signal = np.random.default_rng(8).standard_normal(300).cumsum()
    series = np.stack([signal[20:], signal[13:-7]], axis=1)
    lagged = lagged_correlations(np.diff(series, axis=0), np.array([0]), np.array([1]), 12)
    assert np.argmax(lagged[:, 0]) - 12 == 7
    assert lagged[19, 0] == pytest.approx(1.0, abs=0.1)


def test_a_peak_beyond_the_longest_lag_is_no_lag() -> None:
    slow = waves(5.0, 270.0)
    far = np.argsort(EAST_M)[[0, -1]]
    lags = peak_lags(slow[:, far], EAST_M[far], NORTH_M[far], 1.0, longest_lag_s=20.0)
    found = peak_lags(slow[:, far], EAST_M[far], NORTH_M[far], 1.0)
    assert found.lag_s[0] == pytest.approx((EAST_M[far[1]] - EAST_M[far[0]]) / 5.0, rel=0.1)
    assert np.isnan(lags.lag_s[0]) or abs(lags.lag_s[0]) < 20.0


def test_changes_are_differences_over_the_interval() -> None:
    index = np.array([[0.1], [0.4], [0.2], [0.9]])
    np.testing.assert_allclose(changes(index, 2.0, 4.0), [[0.1], [0.5]])


def test_exceedance_is_the_share_of_larger_changes_in_either_direction() -> None:
    change = np.array([[0.1, -0.3], [0.2, -0.2]])
    np.testing.assert_allclose(
        exceedance(change, np.array([0.0, 0.1, 0.2, 0.3])), [1.0, 0.75, 0.25, 0.0]
    )


def test_shares_of_the_kinds_of_sky() -> None:
    index = np.array([[0.2, 0.5], [0.89, 0.9], [1.0, 1.05], [1.3, 0.4]])
    assert sky_shares(index) == SkyShares(cloudy=0.25, partly=0.25, clear=0.25, enhanced=0.25)
    assert cloud_cover(index) == 0.5


def test_the_index_by_quantile_does_not_depend_on_a_sensors_calibration() -> None:
    irradiance = 100.0 + 900.0 * np.random.default_rng(4).random((200, 3))
    index = index_by_quantile(irradiance)
    np.testing.assert_allclose(index_by_quantile(irradiance * [0.5, 1.0, 3.0]), index)
    np.testing.assert_allclose(np.mean(index > 1.0, axis=0), 0.05)
