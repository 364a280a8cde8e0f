"""Power of inverters from the DC currents of their combiners."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

from sim_plant.dc_current import read_currents
from sim_plant.sites import east_north_m
from sim_plant.sources import MeasuredPlant

CURRENTS = """\
t_s,A-1,A-2,B-1,B-2,B-3
0,50,70,10,20,30
10,60,80,20,30,40
20,90,130,30,40,50
30,-1,0,40,50,60
"""
POSITIONS = """\
combiner,inverter,x_m,y_m
A-1,01,0,0
A-2,01,20,-10
B-1,02,100,0
B-2,02,110,30
B-3,02,120,60
"""

BEGINS = pd.Timestamp("2000-06-21T19:00:00Z")

Read = Callable[..., MeasuredPlant]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_texts(
        currents: str = CURRENTS,
        positions: str = POSITIONS,
        full_power_current: float = 100.0,
    ) -> MeasuredPlant:
        (tmp_path / "hour.csv").write_text(currents)
        (tmp_path / "positions.csv").write_text(positions)
        return read_currents(
            tmp_path / "hour.csv",
            tmp_path / "positions.csv",
            full_power_current,
            BEGINS,
            plant_rating_kw=200.0,
        )

    return read_texts


# Good files ---------------------------------------------------------------------------------------


def test_currents_stay_with_their_times_where_the_newest_line_is_first(read: Read) -> None:
    header, *lines = CURRENTS.splitlines()
    expected, found = read(), read("\n".join([header, *reversed(lines)]))
    assert list(found.measured_times) == list(expected.measured_times)
    np.testing.assert_array_equal(found.power_kw, expected.power_kw)


def test_the_mean_of_the_combiners_is_the_inverters(read: Read) -> None:
    found = read()
    assert found.sites.names == ("inv01", "inv02")
    np.testing.assert_array_equal(found.sites.rating_kw, [100.0, 100.0])
    np.testing.assert_allclose(found.power_kw[:2], [[60.0, 20.0], [70.0, 30.0]])
    assert found.power_kw[2, 0] == 100.0, "more than its rating"
    assert found.power_kw[3, 0] == 0.0, "a small negative current"
    assert found.measured_times.equals(BEGINS + pd.to_timedelta([0, 10, 20, 30], unit="s"))
    assert found.repairs == ()
    east_m, north_m = east_north_m(found.sites.lat_deg, found.sites.lon_deg)
    np.testing.assert_allclose(np.diff(east_m), 110.0 - 10.0)
    np.testing.assert_allclose(np.diff(north_m), 30.0 + 5.0)


# Gaps ---------------------------------------------------------------------------------------------


def test_the_mean_is_over_the_combiners_that_are_there(read: Read) -> None:
    found = read(currents=CURRENTS.replace("10,60,80,20,30,40", "10,60,80,20,,40"))
    np.testing.assert_allclose(found.power_kw[1], [70.0, 30.0])
    (line,) = found.repairs
    assert line.startswith("hour.csv: inverter 02: 1 of 12 currents of its 3 combiners missing")


def test_a_combiner_without_a_column_is_missing_throughout(read: Read) -> None:
    without = "\n".join(line.rpartition(",")[0] for line in CURRENTS.splitlines()) + "\n"
    found = read(currents=without)
    np.testing.assert_allclose(found.power_kw[0], [60.0, 15.0])
    (line,) = found.repairs
    assert line.startswith("hour.csv: inverter 02: 4 of 12 currents of its 3 combiners missing")


# Bad files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("10,60,80", "10,60,201", "hour.csv: line 3, column 'A-2'"),
        ("20,90", "10,90", "hour.csv: line 4, column 't_s'"),
        ("t_s,", "utc,", "hour.csv: line 1: expected the columns t_s"),
        (CURRENTS, "t_s\n0\n10\n", "hour.csv: line 1: expected t_s and"),
        ("A-1,A-2", "A-1,A-9", "positions.csv: expected a line for each combiner"),
        ("A-2,01", "A-1,01", "positions.csv: line 3, column 'combiner'"),
        ("A-2,01", "A-2,a/b", "positions.csv: expected a name"),
    ],
)
def test_one_wrong_field_is_located(read: Read, old: str, new: str, complaint: str) -> None:
    assert (CURRENTS + POSITIONS).count(old) == 1
    texts = CURRENTS.replace(old, new), POSITIONS.replace(old, new)
    assert complaint_of(read, *texts).startswith(complaint)


def test_currents_in_another_unit_are_recognised(read: Read) -> None:
    for current in (1.0, 10_000.0):
        assert "full_power_current" in complaint_of(read, full_power_current=current)


def test_a_line_without_currents_of_an_inverter_is_refused(read: Read) -> None:
    assert "lines without" in complaint_of(read, currents=CURRENTS.replace("10,60,80,", "10,,,"))


def test_a_file_without_any_current_is_refused(read: Read) -> None:
    assert complaint_of(read, currents="t_s,A-1\n0,\n10,\n").startswith("hour.csv: expected")
