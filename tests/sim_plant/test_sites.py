"""Where inverters stand and how large they are, and every way in which the file can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schemas.errors import InputError
from sim_plant.sites import equal_ratings_kw, read_sites

NAMES = "accepted are letters, digits, '_' and '-'"


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


def test_a_rating_of_the_plant_is_split_equally(path: Path) -> None:
    write(path, "inverter,lat,lon", "a,1,2", "b,1,2", "c,1,2", "d,1,2")
    assert read_sites(path, plant_rating_kw=1000.0).rating_kw.tolist() == [250.0] * 4


def test_inverters_may_have_ratings_of_their_own(path: Path) -> None:
    write(path, "rating_kw,lon,lat,inverter", "2500,2,1,a", " 900.5 ,2,1, b ")
    sites = read_sites(path, plant_rating_kw=None)
    assert sites.names == ("a", "b")
    assert sites.rating_kw.tolist() == [2500.0, 900.5]


def test_a_byte_order_mark_is_no_part_of_the_first_column(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbfinverter,lat,lon\na,1,2\n")
    assert read_sites(path, plant_rating_kw=100.0).names == ("a",)


def test_empty_lines_are_passed_over(path: Path) -> None:
    write(path, "inverter,lat,lon", "", "a,1,2", "", "b,1,2", "")
    assert read_sites(path, plant_rating_kw=100.0).names == ("a", "b")


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (
            ["inverter,lon", "a,2"],
            "{path}, line 1: no column 'lat', accepted are inverter, lat, lon and rating_kw",
        ),
        (
            ["name,lat,lon", "a,1,2"],
            "{path}, line 1: no column 'inverter', accepted are inverter, lat, lon and rating_kw",
        ),
        (
            [""],
            "{path}, line 1: no column 'inverter', accepted are inverter, lat, lon and rating_kw",
        ),
        (["inverter,lat,lon"], "{path}: no inverters, accepted is one line for each"),
        (
            ["inverter,lat,lon", "a,1,2", "b,1,2", "a,3,4"],
            "{path}, line 4: inverter a is in line 2 already, names must differ",
        ),
        (["inverter,lat,lon", "a,1,2", ",1,2"], "{path}, line 3: name '', " + NAMES),
        (["inverter,lat,lon", "a/b,1,2"], "{path}, line 2: name 'a/b', " + NAMES),
        (
            ["inverter,lat,lon", "central,1,2"],
            "{path}, line 2: name 'central' is reserved (alive, central, plant, recorder, "
            "replayer), take another",
        ),
        (
            ["inverter,lat,lon", "a,north,2"],
            "{path}, line 2: lat is 'north', accepted is a number from -90 to 90",
        ),
        (
            ["inverter,lat,lon", "a,90.1,2"],
            "{path}, line 2: lat is '90.1', accepted is a number from -90 to 90",
        ),
        (
            ["inverter,lat,lon", "a,nan,2"],
            "{path}, line 2: lat is 'nan', accepted is a number from -90 to 90",
        ),
        (
            ["inverter,lat,lon", "a,1,-180.5"],
            "{path}, line 2: lon is '-180.5', accepted is a number from -180 to 180",
        ),
        (
            ["inverter,lat,lon", "a,1,2", "", "b,x,2"],
            "{path}, line 4: lat is 'x', accepted is a number from -90 to 90",
        ),
        (
            ["inverter,lat,lon", "a,1,2", "b,1"],
            "{path}, line 3: lon is 'empty', accepted is a number from -180 to 180",
        ),
        (
            ["inverter,lat,lon,rating_kw", "a,1,2,5", "b,1,2,-3"],
            "{path}, line 3: rating_kw is '-3', accepted is a number above 0 to 1e+07",
        ),
        (
            ["inverter,lat,lon,rating_kw", "a,1,2,0"],
            "{path}, line 2: rating_kw is '0', accepted is a number above 0 to 1e+07",
        ),
        (
            ["inverter,lat,lon,rating_kw", "a,1,2,"],
            "{path}, line 2: rating_kw is 'empty', accepted is a number above 0 to 1e+07",
        ),
        (
            ["inverter,lat,lon,rating_kw", "a,1,2,inf"],
            "{path}, line 2: rating_kw is 'inf', accepted is a number above 0 to 1e+07",
        ),
    ],
)
def test_what_cannot_be_used_is_told_with_its_place(
    path: Path, lines: list[str], complaint: str
) -> None:
    write(path, *lines)
    with pytest.raises(InputError) as caught:
        read_sites(path, plant_rating_kw=100.0)
    assert str(caught.value) == complaint.format(path=path)


def test_a_file_that_is_not_there_is_refused(path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_sites(path, plant_rating_kw=100.0)
    assert str(caught.value) == f"{path}: no such file, accepted is a CSV of inverters"


def test_a_folder_is_refused(path: Path) -> None:
    path.mkdir()
    with pytest.raises(InputError) as caught:
        read_sites(path, plant_rating_kw=100.0)
    assert str(caught.value) == f"{path}: Is a directory, accepted is a CSV of inverters"


def test_a_file_that_is_not_utf8_is_told_with_the_byte(path: Path) -> None:
    path.write_bytes(b"inverter,lat,lon\n\xe9,1,2\n")
    with pytest.raises(InputError) as caught:
        read_sites(path, plant_rating_kw=100.0)
    assert str(caught.value) == f"{path}: not UTF-8 at byte 17, accepted is a CSV"


def test_without_any_rating_there_is_nothing_to_split(path: Path) -> None:
    write(path, "inverter,lat,lon", "a,1,2")
    with pytest.raises(InputError) as caught:
        read_sites(path, plant_rating_kw=None)
    assert str(caught.value) == (
        f"{path}: no ratings, accepted is plant.rating_kw or a column rating_kw"
    )


def test_equal_ratings_add_up_to_the_plants() -> None:
    assert equal_ratings_kw(900.0, 3, "here").tolist() == [300.0, 300.0, 300.0]
