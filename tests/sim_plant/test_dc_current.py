"""Power of inverters from the DC currents of their combiners."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of

from sim_plant.dc_current import InverterCurrents, read_currents

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

Read = Callable[..., InverterCurrents]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_texts(
        currents: str = CURRENTS,
        positions: str = POSITIONS,
        full_power_current: float = 100.0,
        refuse_gaps: bool = False,
    ) -> InverterCurrents:
        (tmp_path / "hour.csv").write_text(currents)
        (tmp_path / "positions.csv").write_text(positions)
        return read_currents(
            tmp_path / "hour.csv",
            tmp_path / "positions.csv",
            full_power_current,
            refuse_gaps=refuse_gaps,
        )

    return read_texts


# Good files ---------------------------------------------------------------------------------------


def test_the_mean_of_the_combiners_is_the_inverters(read: Read) -> None:
    found = read()
    assert found.inverters == ("01", "02")
    np.testing.assert_allclose(found.share[:3], [[0.6, 0.2], [0.7, 0.3], [1.1, 0.4]])
    np.testing.assert_array_equal(found.time_ns, [0, 10e9, 20e9, 30e9])
    assert found.listed == 2
    assert found.report == ()
    assert found.share[3, 0] == 0.0, "a small negative current"
    np.testing.assert_allclose(found.x_m, [10.0, 110.0])
    np.testing.assert_allclose(found.y_m, [-5.0, 30.0])


def test_fractions_of_a_second_keep_their_step(read: Read) -> None:
    faster = CURRENTS
    for second, text in [(30, "0.3"), (20, "0.2"), (10, "0.1")]:
        faster = faster.replace(f"\n{second},", f"\n{text},")
    np.testing.assert_array_equal(read(currents=faster).time_ns, [0, 100e6, 200e6, 300e6])


# Gaps ---------------------------------------------------------------------------------------------


def test_the_mean_is_over_the_combiners_that_are_there(read: Read) -> None:
    found = read(currents=CURRENTS.replace("10,60,80,20,30,40", "10,60,80,20,,40"))
    np.testing.assert_allclose(found.share[1], [0.7, 0.3])
    assert found.report == (
        "hour.csv: inverter 02: 1 of 12 currents of its 3 combiners missing: the mean is over"
        " those that are there",
    )


def test_a_combiner_without_a_column_is_missing_throughout(read: Read) -> None:
    without = "\n".join(line.rpartition(",")[0] for line in CURRENTS.splitlines()) + "\n"
    found = read(currents=without)
    np.testing.assert_allclose(found.share[0], [0.6, 0.15])
    (told,) = found.report
    assert told.startswith("hour.csv: inverter 02: 4 of 12 currents of its 3 combiners missing")
    assert "inverter 02" in complaint_of(read, currents=without, refuse_gaps=True)


def test_an_inverter_that_comes_and_goes_is_refused(read: Read) -> None:
    gone = CURRENTS.replace("10,60,80,", "10,,,").replace("20,90,130,", "20,,,")
    assert complaint_of(read, currents=gone).startswith("hour.csv: line 3: ")


# Bad files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("10,60,80", "10,60,201", "hour.csv: line 3, column 'A-2'"),
        ("10,60,80", "10,60,-3", "hour.csv: line 3, column 'A-2'"),
        ("20,90", "10,90", "hour.csv: line 4, column 't_s'"),
        ("t_s,", "utc,", "hour.csv: line 1: expected t_s"),
        ("A-1,A-2", "A-1,A-1", "hour.csv: line 1: expected column 'A-1' once"),
        ("A-1,A-2", "A-1,A-9", "positions.csv: expected a line for each combiner"),
        ("inverter,x_m", "inverter,east", "positions.csv: line 1: expected the columns"),
        ("A-2,01,20", "A-2,01,far", "positions.csv: line 3, column 'x_m'"),
        ("A-2,01", "A-1,01", "positions.csv: line 3, column 'combiner'"),
        ("A-2,01", "A-2,a/b", "positions.csv: line 3: name"),
    ],
)
def test_one_wrong_field_is_located(read: Read, old: str, new: str, complaint: str) -> None:
    assert (CURRENTS + POSITIONS).count(old) == 1
    texts = CURRENTS.replace(old, new), POSITIONS.replace(old, new)
    assert complaint_of(read, *texts).startswith(complaint)


def test_currents_in_another_unit_are_recognised(read: Read) -> None:
    for current in (1.0, 10_000.0):
        assert "full_power_current" in complaint_of(read, full_power_current=current)


def test_a_file_without_any_current_is_refused(read: Read) -> None:
    assert complaint_of(read, currents="t_s,A-1\n0,\n10,\n").startswith("hour.csv: expected")
