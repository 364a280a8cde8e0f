"""Where inverters stand and how large they are, and every way in which the file can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of
from hypothesis import given
from hypothesis import strategies as st

from bus_schemas.errors import InputError
from bus_schemas.tree import check_name
from sim_plant.sites import (
    Grid,
    east_north_m,
    inverter_names,
    placed_around,
    read_sites,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "plant.csv"


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_ratings_are_the_inverters_own_or_a_share_of_the_plants(path: Path) -> None:
    write(path, "inverter,lat,lon", "a,1,2", "b,1,2", "c,1,2", "d,1,2")
    assert read_sites(path, plant_rating_kw=1000.0).rating_kw.tolist() == [250.0] * 4
    with pytest.raises(InputError, match=r"expected plant\.rating_kw"):
        read_sites(path, plant_rating_kw=None)
    write(path, "rating_kw,lon,lat,inverter", "2500,2,1,a", " 900.5 ,2,1, b ")
    sites = read_sites(path, plant_rating_kw=None)
    assert sites.names == ("a", "b")
    assert sites.rating_kw.tolist() == [2500.0, 900.5]
    assert read_sites(path, plant_rating_kw=3400.5).names == ("a", "b")
    with pytest.raises(InputError, match=r"plant\.rating_kw: expected none, or 3400\.5, .* 1000"):
        read_sites(path, plant_rating_kw=1000.0)


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["inverter,lat,lon"], "expected 1 to"),
        (["inverter,lat,lon", *(f"n{row},1,2" for row in range(10_001))], "expected 1 to"),
        (["inverter,lat,lon", "a,1,2", "b,1,2", "a,3,4"], "line 4, column 'inverter': expected"),
        (["inverter,lat,lon", "a/b,1,2"], "expected a name"),
        (["inverter,lat,lon", "a,1,-180.5"], "line 2, column 'lon': expected"),
        (["inverter,lat,lon,rating_kw", "a,1,2,5", "b,1,2,0"], "line 3, column 'rating_kw': exp"),
    ],
)
def test_unusable_lines_are_located(path: Path, lines: list[str], complaint: str) -> None:
    write(path, *lines)
    found = complaint_of(read_sites, path, plant_rating_kw=100.0)
    assert found.startswith(f"{path.name}: {complaint}")


def test_an_inverter_is_named_after_its_station() -> None:
    assert inverter_names(["16", "DH3", "inv04"]) == ("inv16", "invDH3", "inv04")
    assert inverter_names(["a/b", "p [1]", "Dach Süd"]) == ("inva-b", "invp-1", "invDach-Sud")


@given(st.lists(st.text(min_size=1, max_size=60), min_size=1, max_size=6, unique=True))
def test_any_station_has_a_node_name_of_its_own(stations: list[str]) -> None:
    names = inverter_names(stations)
    assert len(set(names)) == len(stations)
    for name in names:
        check_name(name, "station")


# Positions ---------------------------------------------------------------------------------------


def test_the_sensors_of_oahu_are_as_far_apart_as_published() -> None:
    # DH1 and AP6 (21.31533 N 158.08700 W, 21.30812 N 158.07935 W), 793 m and 802 m apart.
    east_m, north_m = east_north_m(np.array([21.31533, 21.30812]), np.array([-158.087, -158.07935]))
    np.testing.assert_allclose(np.diff(east_m), 793.0, atol=2.0)
    np.testing.assert_allclose(np.diff(north_m), -802.0, atol=2.0)


def test_inverters_around_a_place_keep_their_distances() -> None:
    x_m, y_m = np.array([700.0, 10.0, 300.0]), np.array([-20.0, 650.0, 300.0])
    east_m, north_m = east_north_m(*placed_around((37.1, -4.2), x_m, y_m))
    for i, j in [(0, 1), (0, 2), (1, 2)]:
        np.testing.assert_allclose(
            np.hypot(east_m[i] - east_m[j], north_m[i] - north_m[j]),
            np.hypot(x_m[i] - x_m[j], y_m[i] - y_m[j]),
            rtol=1e-9,
        )


def test_a_grid_has_its_rows_from_west_to_east_and_from_the_south() -> None:
    sites = Grid(rows=2, columns=3, apart_m=120.0, lat=37.1, lon=-4.2).sites(600.0)
    assert sites.names == tuple(f"inv{number}" for number in range(1, 7))
    assert sites.rating_kw.tolist() == [100.0] * 6
    east_m, north_m = east_north_m(sites.lat_deg, sites.lon_deg)
    np.testing.assert_allclose(east_m, [-120.0, 0.0, 120.0] * 2, atol=0.01)
    np.testing.assert_allclose(north_m, [-60.0] * 3 + [60.0] * 3, atol=0.01)
