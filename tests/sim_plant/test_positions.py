"""Positions in metres and in degrees."""

import numpy as np

from sim_plant.positions import east_north_m, placed_on_the_equator


def test_the_sensors_of_oahu_are_as_far_apart_as_published() -> None:
    # DH1 and AP6 (21.31533 N 158.08700 W, 21.30812 N 158.07935 W), 793 m and 802 m apart.
    east_m, north_m = east_north_m(np.array([21.31533, 21.30812]), np.array([-158.087, -158.07935]))
    np.testing.assert_allclose(np.diff(east_m), 793.0, atol=2.0)
    np.testing.assert_allclose(np.diff(north_m), -802.0, atol=2.0)


def test_a_plant_without_a_place_keeps_its_distances() -> None:
    x_m, y_m = np.array([700.0, 10.0, 300.0]), np.array([-20.0, 650.0, 300.0])
    east_m, north_m = east_north_m(*placed_on_the_equator(x_m, y_m))
    for i, j in [(0, 1), (0, 2), (1, 2)]:
        np.testing.assert_allclose(
            np.hypot(east_m[i] - east_m[j], north_m[i] - north_m[j]),
            np.hypot(x_m[i] - x_m[j], y_m[i] - y_m[j]),
            rtol=1e-9,
        )
