"""Where inverters stand and how large they are, and every way in which the file can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from complaints import complaint_of

from bus_schemas.errors import InputError
from sim_plant.sites import inverter_name, read_sites


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "plant.csv"


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_plant_is_read_line_by_line(path: Path) -> None:
    write(path, "inverter,station,lat,lon", "inv01,DH1,21.31533,-158.087", "inv02,DH2,-90,180")
    sites = read_sites(path, plant_rating_kw=8000.0)
    assert sites.names == ("inv01", "inv02")
    assert sites.lat_deg.tolist() == [21.31533, -90.0]
    assert sites.lon_deg.tolist() == [-158.087, 180.0]


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
        (["inverter,lon", "a,1"], "line 1: expected the columns inverter, lat, lon"),
        (["inverter,lat,lon"], "expected a line"),
        (["inverter,lat,lon", *(f"n{row},1,2" for row in range(5000))], "expected a line"),
        (["inverter,lat,lon", "a,1,2", "b,1,2", "a,3,4"], "line 4, column 'inverter': expected"),
        (["inverter,lat,lon", "a,1,2", ",1,2"], "line 3: name: expected"),
        (["inverter,lat,lon", "a/b,1,2"], "line 2: name: expected"),
        (["inverter,lat,lon", "central,1,2"], "line 2: name: expected"),
        (["inverter,lat,lon", "a,north,2"], "line 2, column 'lat': expected"),
        (["inverter,lat,lon", "a,1,-180.5"], "line 2, column 'lon': expected"),
        (["inverter,lat,lon,rating_kw", "a,1,2,5", "b,1,2,0"], "line 3, column 'rating_kw': exp"),
        (["inverter,lat,lon,rating_kw", "a,1,2,inf"], "line 2, column 'rating_kw': expected"),
    ],
)
def test_what_cannot_be_used_is_located(path: Path, lines: list[str], complaint: str) -> None:
    write(path, *lines)
    found = complaint_of(read_sites, path, plant_rating_kw=100.0)
    assert found.startswith(f"{path.name}: {complaint}")


@pytest.mark.parametrize(
    ("station", "name"), [("16", "inv16"), ("DH3", "invDH3"), ("inv04", "inv04")]
)
def test_an_inverter_is_named_after_its_station(station: str, name: str) -> None:
    assert inverter_name(station) == name
