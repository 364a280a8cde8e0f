"""Daily files of the Oahu grid: made here in their format, since the real ones may not be had."""

from collections.abc import Callable
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of
from oahu_days import day_text

from sim_plant import Floats
from sim_plant.irradiance import Irradiance
from sim_plant.oahu_grid import HORIZONTAL, latest_day_before, read_day

DAY = date(2010, 4, 1)
FIELDS = (
    *("DH3", "DH4", "DH5", "DH10", "DH11", "DH9", "DH2", "DH1", "DH1T", "AP6", "AP6T"),
    *("AP1", "AP3", "AP5", "AP4", "AP7", "DH6", "DH7", "DH8"),
)
POSITIONS = Path(__file__).resolve().parents[2] / "scenarios" / "shipped" / "oahu.csv"

Read = Callable[..., Irradiance]


def some_minutes() -> Floats:
    """Field number times 10 plus the second: every value is known."""
    return 10.0 * np.arange(5, 24) + np.arange(150.0)[:, None]


def column(sensor: str) -> int:
    return FIELDS.index(sensor)


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_text(text: str, **options: object) -> Irradiance:
        (tmp_path / "20100401.txt").write_text(text)
        options = {"most_missing": 0.2} | options
        return read_day(tmp_path, DAY, POSITIONS, **options)  # type: ignore[arg-type]

    return read_text


def message_of(read: Read, text: str, **options: object) -> str:
    message = complaint_of(read, text, **options)
    return message[message.find("20100401.txt") :] if "20100401.txt" in message else message


# Good files ---------------------------------------------------------------------------------------


def test_each_sensor_has_its_own_field_and_the_tilted_have_none(read: Read) -> None:
    ghi_wm2 = some_minutes()
    ghi_wm2[3, column("DH4")] = -0.7
    found = read(day_text(DAY, ghi_wm2), stations=None)
    assert found.sensors == HORIZONTAL
    assert len(HORIZONTAL) == 17
    assert not {"DH1T", "AP6T", "AP2"} & set(HORIZONTAL)
    for sensor, value in found.ghi_wm2.iloc[7].items():
        assert value == 10.0 * (5 + column(str(sensor))) + 7.0
    assert found.ghi_wm2["DH4"].iloc[3] == 0.0, "a small negative of the night"
    assert found.report == ("20100401.txt: set to 0: 1 of the values, from -0.7 W/m2 up",)


# Gaps ---------------------------------------------------------------------------------------------


def with_gap(sensor: str, rows: slice) -> Floats:
    ghi_wm2 = some_minutes()
    ghi_wm2[rows, column(sensor)] = np.nan
    return ghi_wm2


def test_a_gap_is_filled_and_reported(read: Read) -> None:
    found = read(day_text(DAY, with_gap("DH8", slice(40, 60))), stations=["DH6", "DH8"])
    (line,) = found.report
    assert line.startswith("20100401.txt: DH8: 20 of 150 values missing")
    truth = some_minutes()[40:60, column("DH8")]
    np.testing.assert_allclose(found.ghi_wm2["DH8"][40:60], truth, rtol=0.02)


def test_a_day_without_any_sensor_is_refused(read: Read) -> None:
    text = day_text(DAY, np.full((150, 19), np.nan))
    assert message_of(read, text).startswith("20100401.txt: expected at least one sensor")


# Bad files ----------------------------------------------------------------------------------------

GOOD = "0,2010,91,1200" + ",500" * 19 + "\n1,2010,91,1200" + ",600" * 19 + "\n"
GOOD += "2,2010,91,1200" + ",700" * 19 + "\n3,2010,91,1200" + ",800" * 19 + "\n"


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("2,2010,91,1200,700", "2,2010,91,1200,n/a", "line 3, column 'DH3': expected a number"),
        ("2,2010,91,1200,700", "2,2010,91,1200,2100", "line 3, column 'DH3': expected -20 to"),
        ("2,2010,91", "2,2010,92", "line 3, column 'day of year': expected that"),
        ("2,2010,91,1200", "2,2010,91,1260", "line 3, column 'second': expected times"),
        ("2,2010,91,1200", "1,2010,91,1200", "line 3, column 'second': expected times"),
    ],
)
def test_one_wrong_field_is_located(read: Read, old: str, new: str, place: str) -> None:
    assert GOOD.count(old) == 1
    assert message_of(read, GOOD.replace(old, new)).startswith(f"20100401.txt: {place}")


# Earlier days -------------------------------------------------------------------------------------


def test_the_latest_earlier_day_is_found_among_other_files(tmp_path: Path) -> None:
    for name in ("notes", "20100328", "20100331", "20100401", "20100402", "20109999"):
        (tmp_path / f"{name}.txt").write_text(GOOD)
    assert latest_day_before(tmp_path, DAY) == date(2010, 3, 31)
