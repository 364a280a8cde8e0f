"""Reading measured irradiance, and every way in which such a file can be wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

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
        ghi: str = GHI,
        positions: str = POSITIONS,
        stations: list[str] | None = None,
        max_gap_s: float | None = None,
    ) -> Irradiance:
        (tmp_path / "ghi.csv").write_text(ghi, encoding="utf-8")
        (tmp_path / "positions.csv").write_text(positions, encoding="utf-8")
        paths = tmp_path / "ghi.csv", tmp_path / "positions.csv"
        return read_measured_ghi(*paths, stations, max_gap_s)

    return read_texts


def test_columns_positions_and_times_belong_together(read: Read) -> None:
    found = read()
    assert found.sensors == ("DH3", "AP1", "DH4")
    assert found.coordinates["lat"].tolist() == [21.31236, 21.31276, 21.31303]
    assert found.coordinates["lon"].tolist() == [-158.08463, -158.08389, -158.08505]
    np.testing.assert_array_equal(found.ghi_wm2[:2], [[800.5, 790.0, 0.0], [801.5, 791.0, 10.0]])
    assert str(found.times.tz) == "UTC"
    assert found.times[-1] == pd.Timestamp("2010-04-01T20:00:03Z")


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("801.5,791.0", "801.5,2001", "ghi.csv: line 3, column 'AP1'"),
        ("801.5,791.0", "801.5,-20.1", "ghi.csv: line 3, column 'AP1'"),
        ("20:00:02Z", "20:00:01Z", "ghi.csv: line 4, column 'utc'"),
        ("DH4,21", "DH3,21", "positions.csv: line 4, column 'station'"),
        ("-158.08505", "201.9", "positions.csv: line 4, column 'lon'"),
    ],
)
def test_one_wrong_field_is_located(read: Read, old: str, new: str, complaint: str) -> None:
    assert (GHI + POSITIONS).count(old) == 1
    texts = GHI.replace(old, new), POSITIONS.replace(old, new)
    assert complaint_of(read, *texts).startswith(complaint)


@pytest.mark.parametrize(
    ("stations", "named"),
    [(["DH3", "DH9"], "DH3, DH9"), (["DH3", "DH3"], "DH3, DH3"), ([], "none")],
)
def test_stations_are_refused(read: Read, stations: list[str], named: str) -> None:
    complaint = complaint_of(read, stations=stations)
    assert complaint.startswith("ghi.csv: line 1: stations: expected")
    assert complaint.endswith(named)


def test_a_file_that_lacks_a_station_is_not_taken_for_a_smaller_plant(read: Read) -> None:
    more = POSITIONS + "DH9,21.3,-158.0,0.0\n"
    assert "got none for DH9" in complaint_of(read, positions=more)
    assert read(positions=more, stations=["DH3", "DH4"]).sensors == ("DH3", "DH4")


GAPS = """\
utc,DH3,AP1,DH4
2010-04-01T20:00:00Z,NaN,790,100
2010-04-01T20:00:01Z,801,,110
2010-04-01T20:00:04Z,804,802,140
2010-04-01T20:00:05Z,805,803,150
"""


def test_missing_values_and_lines_are_filled_on_straight_lines_and_told(read: Read) -> None:
    found = read(GAPS, max_gap_s=3.0)
    assert (found.times == pd.date_range("2010-04-01T20:00:00Z", periods=6, freq="s")).all()
    expected = [
        *([801.0, 790.0, 100.0], [801.0, 793.0, 110.0], [802.0, 796.0, 120.0]),
        *([803.0, 799.0, 130.0], [804.0, 802.0, 140.0], [805.0, 803.0, 150.0]),
    ]
    np.testing.assert_allclose(found.ghi_wm2, expected)
    (line,) = found.report
    assert line.startswith("ghi.csv: 8 of 18 values were missing, in gaps of at most 3 s")
    assert line.endswith("DH3 3, AP1 3, DH4 2")


def test_a_file_without_gaps_is_read_the_same_whether_gaps_are_filled_or_not(read: Read) -> None:
    refused, filled = read(), read(max_gap_s=3.0)
    pd.testing.assert_frame_equal(refused.ghi_wm2, filled.ghi_wm2, check_freq=False)
    assert filled.report == ("ghi.csv: set to 0: 1 of the values, from -0.7 W/m2 up",)


@pytest.mark.parametrize(
    ("ghi", "named"),
    [
        (GAPS, ["at most 2 s", "3 s of AP1 (see line 2)"]),
        (GAPS.replace("804,", ",").replace("801,", ",").replace("805,", ","), ["got none of DH3"]),
        (
            GAPS.replace("00:01Z", "00:00Z").replace("00:05Z", "00:03Z"),
            ["all such lines: 3, 5"],
        ),
        (GAPS.replace("00:04Z", "00:03.5Z"), ["all such lines: 3"]),
    ],
)
def test_gaps_that_cannot_be_filled_are_refused(read: Read, ghi: str, named: list[str]) -> None:
    complaint = complaint_of(read, ghi, max_gap_s=2.0)
    assert [one for one in named if one not in complaint] == []
