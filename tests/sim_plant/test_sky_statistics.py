"""Statistics of a sky: on patterns whose answer is known, and on a plant whose clouds are."""

from pathlib import Path

import numpy as np
import pytest
from sky_statistics import cloud_motion, real_plant

from sim_plant import Floats

RNG = np.random.default_rng(5)
EAST_M, NORTH_M = 1000.0 * RNG.random((2, 15))


def waves(speed_ms: float, from_deg: float, step_s: float = 1.0, count: int = 1200) -> Floats:
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


@pytest.mark.parametrize(("hour", "speed_ms", "angle_rad"), [("a", 10.7, 3.29), ("c", 3.14, 1.92)])
def test_the_motion_over_a_real_plant_is_the_one_that_its_publisher_found(
    data_folder: Path, hour: str, speed_ms: float, angle_rad: float
) -> None:
    current, east_m, north_m, averaging = real_plant(data_folder / "plant20mw-combiners-10s", hour)
    motion = cloud_motion(current @ averaging, east_m @ averaging, north_m @ averaging, 10.0)
    # The angle is that of the velocity, counter-clockwise from east.
    from_deg = (270.0 - np.rad2deg(angle_rad)) % 360.0
    assert motion.speed_ms == pytest.approx(speed_ms, rel=0.1)
    assert motion.from_deg == pytest.approx(from_deg, abs=5.0)
