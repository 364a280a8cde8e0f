"""Reading measured irradiance, and every way in which such a file can be wrong."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bus_schemas.errors import InputError
from sim_plant.irradiance import Irradiance, read_measured_ghi

GHI = """\
utc,DH3,AP1,DH4
2010-04-01T20:00:00Z,800.5,790.0,-0.7
2010-04-01T20:00:01Z,801.5,791.0,10
2010-04-01T20:00:02Z,802.5,792.0,20
2010-04-01T20:00:03Z,803.5,793.0,30
"""
POSITIONS = """\
station,lat,lon,x_m
AP1,21.31276,-158.08389,322.5
DH3,21.31236,-158.08463,245.8
DH4,21.31303,-158.08505,202.2
"""

Read = Callable[..., Irradiance]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_texts(
        ghi: str = GHI, positions: str = POSITIONS, stations: list[str] | None = None
    ) -> Irradiance:
        (tmp_path / "ghi.csv").write_text(ghi, encoding="utf-8")
        (tmp_path / "positions.csv").write_text(positions, encoding="utf-8")
        return read_measured_ghi(tmp_path / "ghi.csv", tmp_path / "positions.csv", stations)

    return read_texts


def message_of(read: Read, **texts: object) -> str:
    with pytest.raises(InputError) as caught:
        read(**texts)
    message = str(caught.value)
    assert "\n" not in message
    return message


def hope_files() -> tuple[Path, Path]:
    default = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("HELIARCH_DATA", default)) / "hope-melpitz-1s"
    files = folder / "ghi_20130908_0915_0955.csv", folder / "positions.csv"
    for file in files:
        if not file.is_file():
            pytest.skip(f"measured data is absent: {file} (HELIARCH_DATA names its folder)")
    return files


def test_columns_positions_and_times_belong_together(read: Read) -> None:
    found = read()
    assert found.sensors == ("DH3", "AP1", "DH4")
    np.testing.assert_array_equal(found.lat_deg, [21.31236, 21.31276, 21.31303])
    np.testing.assert_array_equal(found.lon_deg, [-158.08463, -158.08389, -158.08505])
    np.testing.assert_array_equal(found.ghi_wm2[1], [801.5, 791.0, 10.0])
    assert found.ghi_wm2.dtype == np.float64
    assert str(found.times.tz) == "UTC"
    assert found.times[-1] == pd.Timestamp("2010-04-01T20:00:03Z")


def test_a_small_negative_offset_is_set_to_zero(read: Read) -> None:
    assert read().ghi_wm2[0, 2] == 0.0


def test_stations_are_taken_in_the_order_asked_for(read: Read) -> None:
    found = read(stations=["DH4", "DH3"])
    assert found.sensors == ("DH4", "DH3")
    np.testing.assert_array_equal(found.ghi_wm2[2], [20.0, 802.5])
    np.testing.assert_array_equal(found.lat_deg, [21.31303, 21.31236])


def test_a_bad_value_of_a_station_not_asked_for_does_no_harm(read: Read) -> None:
    found = read(ghi=GHI.replace("791.0", "broken"), stations=["DH3"])
    np.testing.assert_array_equal(found.ghi_wm2[:, 0], [800.5, 801.5, 802.5, 803.5])


def test_an_offset_from_utc_is_taken_into_account(read: Read) -> None:
    local = GHI.replace("T20:", " 10:").replace("Z,", "-10:00,").replace("utc,", "Hawaii,")
    assert read(ghi=local).times.equals(read().times)


def test_fractions_of_a_second_are_kept(read: Read) -> None:
    faster = GHI
    for second in range(4):
        faster = faster.replace(f":0{second}Z", f":00.{25 * second:02d}Z")
    assert read(ghi=faster).times[1] == pd.Timestamp("2010-04-01T20:00:00.25Z")


def test_quotes_a_byte_order_mark_and_windows_line_ends_are_read(read: Read) -> None:
    dressed = "\ufeff" + GHI.replace("DH3", '"DH3"').replace("\n", "\r\n")
    np.testing.assert_array_equal(read(ghi=dressed).ghi_wm2, read().ghi_wm2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "791.0",
            "n/a",
            "ghi.csv: line 3, column 'AP1': found 'n/a'; accepted: a number in W/m2",
        ),
        (
            "791.0",
            "abc",
            "ghi.csv: line 3, column 'AP1': found 'abc'; accepted: a number in W/m2",
        ),
        (
            "803.5",
            "",
            "ghi.csv: line 5, column 'DH3': found an empty field; accepted: a number in W/m2",
        ),
        (
            "801.5",
            "NaN",
            "ghi.csv: line 3, column 'DH3': found 'NaN'; accepted: a number in W/m2",
        ),
        (
            "791.0",
            "2000.5",
            "ghi.csv: line 3, column 'AP1': found '2000.5'; accepted: -10 to 2000 W/m2",
        ),
        (
            "791.0",
            "-99999",
            "ghi.csv: line 3, column 'AP1': found '-99999'; accepted: -10 to 2000 W/m2",
        ),
        (
            "791.0",
            "inf",
            "ghi.csv: line 3, column 'AP1': found 'inf'; accepted: -10 to 2000 W/m2",
        ),
        (
            "801.5,791.0,10",
            "801.5,791.0",
            "ghi.csv: line 3: 3 fields; accepted: 4, as in the header",
        ),
        (
            "801.5,791.0,10",
            "801.5,791.0,10,5",
            "ghi.csv: line 3: 5 fields; accepted: 4, as in the header",
        ),
        (
            "800.5,790.0,-0.7",
            "800.5,790.0,-0.7,5",
            "ghi.csv: line 2: 5 fields; accepted: 4, as in the header",
        ),
        (
            "2010-04-01T20:00:02Z",
            "\n2010-04-01T20:00:02Z",
            "ghi.csv: line 4: 0 fields; accepted: 4, as in the header",
        ),
        (
            "20:00:02Z",
            "20:00:01Z",
            "ghi.csv: line 4, column 'utc': found '2010-04-01T20:00:01Z' repeats line 3;"
            " accepted: one step of 1 s throughout",
        ),
        (
            "20:00:02Z",
            "19:59:58Z",
            "ghi.csv: line 4, column 'utc': found '2010-04-01T19:59:58Z' goes back 3 s from line 3;"
            " accepted: one step of 1 s throughout",
        ),
        (
            "20:00:03Z",
            "20:00:09Z",
            "ghi.csv: line 5, column 'utc': found '2010-04-01T20:00:09Z' is 7 s after line 4;"
            " accepted: one step of 1 s throughout",
        ),
        (
            "20:00:03Z",
            "20:00:02.5Z",
            "ghi.csv: line 5, column 'utc': found '2010-04-01T20:00:02.5Z' is 0.5 s after line 4;"
            " accepted: one step of 1 s throughout",
        ),
        (
            "2010-04-01T20:00:01Z",
            "2010-04-01T20:00:01",
            "ghi.csv: line 3, column 'utc': found '2010-04-01T20:00:01';"
            " accepted: ISO 8601 with Z or an offset, e.g. 2013-09-08T09:15:00Z",
        ),
        (
            "2010-04-01T20:00:01Z",
            "2010-13-01T20:00:01Z",
            "ghi.csv: line 3, column 'utc': found '2010-13-01T20:00:01Z';"
            " accepted: ISO 8601 with Z or an offset, e.g. 2013-09-08T09:15:00Z",
        ),
        (
            "2010-04-01T20:00:01Z",
            "",
            "ghi.csv: line 3, column 'utc': found an empty field;"
            " accepted: ISO 8601 with Z or an offset, e.g. 2013-09-08T09:15:00Z",
        ),
        (
            "utc,DH3,AP1",
            "utc,DH3,DH3",
            "ghi.csv: line 1: column 'DH3' is there twice; accepted: one per station",
        ),
        (
            "utc,DH3,AP1,DH4",
            "utc,DH3,AP1,DH5",
            "positions.csv: no position for station 'DH5'; accepted: a line for each station",
        ),
    ],
)
def test_one_wrong_field_of_the_measurements_is_located(
    read: Read, old: str, new: str, message: str
) -> None:
    assert GHI.count(old) == 1
    assert message_of(read, ghi=GHI.replace(old, new)) == message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "station,lat,lon",
            "station,lat,longitude",
            "positions.csv: line 1: no column 'lon'; accepted: the columns station, lat, lon;"
            " found station, lat, longitude, x_m",
        ),
        (
            "station,lat",
            "name,lat",
            "positions.csv: line 1: no column 'station'; accepted: the columns station, lat, lon;"
            " found name, lat, lon, x_m",
        ),
        (
            "21.31236",
            "north",
            "positions.csv: line 3, column 'lat': found 'north'; accepted: degrees from -90 to 90",
        ),
        (
            "21.31236",
            "nan",
            "positions.csv: line 3, column 'lat': found 'nan'; accepted: degrees from -90 to 90",
        ),
        (
            "-158.08505",
            "201.9",
            "positions.csv: line 4, column 'lon': found '201.9';"
            " accepted: degrees from -180 to 180",
        ),
        (
            "21.31236",
            "",
            "positions.csv: line 3, column 'lat': found an empty field;"
            " accepted: degrees from -90 to 90",
        ),
        (
            "DH4,",
            "DH3,",
            "positions.csv: line 4: station 'DH3' is there twice;"
            " accepted: one position per station",
        ),
        (
            "-158.08463,245.8",
            "-158.08463",
            "positions.csv: line 3: 3 fields; accepted: 4, as in the header",
        ),
    ],
)
def test_one_wrong_field_of_the_positions_is_located(
    read: Read, old: str, new: str, message: str
) -> None:
    assert POSITIONS.count(old) == 1
    assert message_of(read, positions=POSITIONS.replace(old, new)) == message


def test_a_station_without_a_column_is_named(read: Read) -> None:
    assert message_of(read, stations=["DH3", "DH9"]) == (
        "ghi.csv: line 1: no column for station 'DH9'; its stations are DH3, AP1, DH4"
    )


def test_a_station_asked_for_twice_is_named(read: Read) -> None:
    assert message_of(read, stations=["DH3", "DH3"]) == (
        "stations: 'DH3' is there twice; accepted: each station once"
    )


def test_a_file_without_stations_is_refused(read: Read) -> None:
    assert message_of(read, ghi="utc\n2010-04-01T20:00:00Z\n") == (
        "ghi.csv: line 1: no station; accepted: at least one column of GHI"
    )


def test_kilowatts_are_recognised(read: Read) -> None:
    kilowatts = (
        "utc,DH3\n2010-04-01T20:00:00Z,0.8005\n2010-04-01T20:00:01Z,1.103\n"
        "2010-04-01T20:00:02Z,-0.001\n"
    )
    assert message_of(read, ghi=kilowatts) == (
        "ghi.csv: the largest value is 1.103, so the unit seems to be kW/m2;"
        " accepted: W/m2, with a maximum of at least 2"
    )


def test_a_dark_night_is_not_taken_for_kilowatts(read: Read) -> None:
    night = "utc,DH3\n2010-04-01T10:00:00Z,-0.7\n2010-04-01T10:00:01Z,0\n"
    assert not read(ghi=night).ghi_wm2.any()


@pytest.mark.parametrize("rows", [0, 1])
def test_less_than_two_rows_have_no_step(read: Read, rows: int) -> None:
    short = "\n".join(GHI.splitlines()[: 1 + rows]) + "\n"
    assert message_of(read, ghi=short) == (
        f"ghi.csv: {rows} rows below the header; accepted: at least 2"
    )


def test_an_empty_file_is_refused(read: Read) -> None:
    assert message_of(read, ghi="") == (
        "ghi.csv: is empty; accepted: a CSV file with a header line"
    )


def test_a_time_stamp_that_never_moves_is_refused(read: Read) -> None:
    still = "utc,DH3\n" + "2010-04-01T20:00:00Z,5\n" * 3
    assert message_of(read, ghi=still) == (
        "ghi.csv: line 3, column 'utc': found '2010-04-01T20:00:00Z' repeats line 2;"
        " accepted: one step above 0 s throughout"
    )


def test_a_gap_at_the_top_is_not_taken_for_the_step(read: Read) -> None:
    gap = GHI.replace("20:00:00Z", "19:00:00Z")
    assert message_of(read, ghi=gap) == (
        "ghi.csv: line 3, column 'utc': found '2010-04-01T20:00:01Z' is 3601 s after line 2;"
        " accepted: one step of 1 s throughout"
    )


@pytest.mark.parametrize("missing", ["ghi.csv", "positions.csv"])
def test_a_missing_file_is_named(tmp_path: Path, missing: str) -> None:
    (tmp_path / "ghi.csv").write_text(GHI)
    (tmp_path / "positions.csv").write_text(POSITIONS)
    (tmp_path / missing).unlink()
    with pytest.raises(InputError) as caught:
        read_measured_ghi(tmp_path / "ghi.csv", tmp_path / "positions.csv")
    assert str(caught.value) == (
        f"{tmp_path / missing}: cannot be read: No such file or directory;"
        " accepted: a CSV file in UTF-8"
    )


@pytest.mark.parametrize("line", [0, 3])
def test_a_file_that_is_not_text_is_named(tmp_path: Path, line: int) -> None:
    lines = GHI.encode().splitlines(keepends=True)
    lines[line] = b"\xff\xfe" + lines[line]
    (tmp_path / "ghi.csv").write_bytes(b"".join(lines))
    (tmp_path / "positions.csv").write_text(POSITIONS)
    with pytest.raises(InputError) as caught:
        read_measured_ghi(tmp_path / "ghi.csv", tmp_path / "positions.csv")
    message = str(caught.value)
    assert "ghi.csv: cannot be read: 'utf-8' codec can't decode byte 0xff" in message
    assert "\n" not in message


def test_a_day_of_17_sensors_is_read(tmp_path: Path) -> None:
    stations = [f"S{i}" for i in range(17)]
    seconds = pd.date_range("2010-04-01T15:00:00Z", periods=54_000, freq="1s")
    stamps = seconds.strftime("%Y-%m-%dT%H:%M:%SZ")
    ghi = 1000.0 * np.random.default_rng(1).random((1000, 17))
    rows = [",".join(f"{v:.3f}" for v in row) for row in ghi]
    lines = [f"{stamp},{rows[i % 1000]}" for i, stamp in enumerate(stamps)]
    (tmp_path / "g.csv").write_text("\n".join([",".join(["utc", *stations]), *lines]) + "\n")
    places = [f"{s},21.3,-158.0" for s in stations]
    (tmp_path / "p.csv").write_text("\n".join(["station,lat,lon", *places]) + "\n")
    found = read_measured_ghi(tmp_path / "g.csv", tmp_path / "p.csv")
    np.testing.assert_array_equal(found.ghi_wm2[53_500], [float(v) for v in rows[500].split(",")])


def test_the_hope_measurements_are_read() -> None:
    found = read_measured_ghi(*hope_files())
    assert found.ghi_wm2.shape == (2400, 50)
    assert found.sensors[:3] == ("2", "7", "14")
    assert found.times[0] == pd.Timestamp("2013-09-08T09:15:00Z")
    assert found.ghi_wm2[0, 0] == 338.107
    assert found.lat_deg[0] == 51.525642
