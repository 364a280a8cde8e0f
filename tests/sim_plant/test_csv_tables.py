"""CSV files: each fault is reported with file, line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of

from bus_schemas.errors import InputError
from sim_plant.csv_tables import CsvTable, read_csv

TEXT = "utc, a ,b\n2010-04-01T20:00:00Z,1,2\n2010-04-01T20:00:01Z,3,\n2010-04-01T20:00:02Z,-1.5,6\n"


def read(folder: Path, text: str = TEXT) -> CsvTable:
    (folder / "x.csv").write_text(text, encoding="utf-8")
    return read_csv(folder / "x.csv")


def test_columns_are_numbers_and_an_empty_field_may_be_missing(tmp_path: Path) -> None:
    table = read(tmp_path, f"\ufeff{TEXT}\n\n")
    assert table.header == ("utc", "a", "b")
    found = table.numbers(("b", "a"), empty_is_missing=True)
    np.testing.assert_array_equal(found, [[2.0, 1.0], [np.nan, 3.0], [6.0, -1.5]])
    assert str(table.times("utc")[1]) == "2010-04-01 20:00:01+00:00"


def test_rows_that_are_picked_keep_their_lines(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^x\.csv: line 4, column 'a': expected .*, got '-1.5'$"):
        read(tmp_path).picked([2, 0]).numbers(("a",), low=0.0)


@pytest.mark.parametrize("bad", ["x", "", "nan", "inf", "2 MW", "7.5"])
def test_a_value_that_is_not_as_expected_is_located(tmp_path: Path, bad: str) -> None:
    table = read(tmp_path, TEXT.replace(",3,", f",{bad},"))
    with pytest.raises(
        InputError, match=rf"^x\.csv: line 3, column 'a': expected kW, got '{bad}'$"
    ):
        table.numbers(("a",), "kW", -5.0, 7.0)


@pytest.mark.parametrize(
    "stamp", ["2010-04-01T20:00:01", "2010-13-01T20:00:01Z", "", "2010-04-01", "20:00:01Z"]
)
def test_a_time_stamp_without_a_zone_is_refused(tmp_path: Path, stamp: str) -> None:
    table = read(tmp_path, TEXT.replace("2010-04-01T20:00:01Z", stamp))
    with pytest.raises(InputError, match=rf"line 3, column 'utc': expected .*, got '{stamp}'$"):
        table.times("utc")


@pytest.mark.parametrize("text", ["s\n0\n2\n4\n9\n", "s\n0\n2\n4\n4\n", "s\n0\n2\n4\n3\n"])
def test_seconds_keep_one_step(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="line 5, column 's': expected a time 2 s after"):
        read(tmp_path, text).seconds_ns("s")


@pytest.mark.parametrize("text", ["s\n", "s\n0\n"])
def test_less_than_two_rows_have_no_step(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"^x\.csv: expected at least 2 rows"):
        read(tmp_path, text).seconds_ns("s")


@pytest.mark.parametrize("times", [[0, 3601, 3602, 3603], [0, 0, 0, 0]])
def test_a_gap_at_the_top_is_no_step(tmp_path: Path, times: list[int]) -> None:
    with pytest.raises(InputError, match="line 3, column 's'"):
        read(tmp_path, "\n".join(["s", *map(str, times)])).seconds_ns("s")


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (TEXT, "", "x.csv: expected"),
        (",", ";", "x.csv: line 1: expected commas between the fields, got semicolons"),
        (",3,", ",3", "x.csv: line 3: expected 3 fields, as in line 1, got 2"),
        (",3,", ",3,4,5", "x.csv: line 3: expected 3 fields, as in line 1, got 4"),
        ("2010-04-01T20:00:01", "\n2010-04-01T20:00:01", "x.csv: line 3: expected 3 fields"),
        (" a ", "b", "x.csv: line 1: expected column 'b' once"),
        (" a ", "c", "x.csv: line 1: expected the columns a, b, got utc, c, b"),
    ],
)
def test_another_form_is_refused(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    def checked() -> None:
        table = read(tmp_path, TEXT.replace(old, new))
        table.check_no_column_twice()
        table.check_header(("a", "b"))

    assert complaint_of(checked).startswith(complaint)


def test_what_is_no_text_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "latin.csv").write_bytes(b"a,b\n\xe9,1\n")
    for path in (tmp_path, tmp_path / "nowhere.csv", tmp_path / "latin.csv"):
        with pytest.raises(InputError, match=f"^{path}: expected"):
            read_csv(path)
