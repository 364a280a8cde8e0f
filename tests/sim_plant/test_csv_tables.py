"""CSV files: each fault is reported with file, line and column."""

from __future__ import annotations

import os
from collections.abc import Sequence
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
    assert (table.stamp, *table.value_columns) == ("utc", "a", "b")
    found = table.numbers(("b", "a"), empty_is_missing=True)
    np.testing.assert_array_equal(found, [[2.0, 1.0], [np.nan, 3.0], [6.0, -1.5]])
    assert str(table.times(None)[1]) == "2010-04-01 20:00:01+00:00"
    assert table.said() == ()


@pytest.mark.parametrize("bad", ["x", "", "nan", "inf", "7.5"])
def test_a_value_that_is_not_as_expected_is_located(tmp_path: Path, bad: str) -> None:
    table = read(tmp_path, TEXT.replace(",3,", f",{bad},"))
    found = complaint_of(table.numbers, ("a",), "kW", -5.0, 7.0)
    got = "nothing" if bad in {"", "nan"} else repr(bad)
    assert found == f"x.csv: line 3, column 'a': expected kW, got {got}"


@pytest.mark.parametrize(
    "stamp", ["2010-04-01T20:00:01", "2010-13-01T20:00:01Z", "", "2010-04-01", "20:00:01Z"]
)
def test_a_time_stamp_without_a_zone_is_refused(tmp_path: Path, stamp: str) -> None:
    table = read(tmp_path, TEXT.replace("2010-04-01T20:00:01Z", stamp))
    found = complaint_of(table.times, None)
    assert found.startswith("x.csv: line 3, column 'utc': expected")


def seconds_and_values(times: Sequence[float]) -> str:
    return "\n".join(["s,v", *(f"{time},1" for time in times)])


def seconds(table: CsvTable) -> None:
    table.steady("s", table.seconds_ns("s"))


@pytest.mark.parametrize(
    ("times", "place"),
    [
        ([0, 2, 4, 9], "x.csv: line 5, column 's'"),
        ([0, 2, 4, 4], "x.csv: line 5, column 's'"),
        ([0, 2, 4, 3], "x.csv: line 5, column 's'"),
        ([0, 3601, 3602, 3603], "x.csv: line 3, column 's'"),
        ([0, 0, 0, 0], "x.csv: line 3, column 's'"),
        ([0], "x.csv: expected at least 2 rows"),
    ],
)
def test_seconds_keep_one_step(tmp_path: Path, times: list[int], place: str) -> None:
    table = read(tmp_path, seconds_and_values(times))
    assert complaint_of(seconds, table).startswith(place)


def test_the_usual_step_is_named_where_there_is_one(tmp_path: Path) -> None:
    for times, is_named in (([0, 2, 4, 9], True), ([4, 3, 3, 1], False)):
        table = read(tmp_path, seconds_and_values(times))
        assert ("here mostly 2 s" in complaint_of(seconds, table)) == is_named
        assert "e-09" not in complaint_of(seconds, table)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (TEXT, "", "expected a CSV file"),
        ("utc, a ,b", "utc,c,d", "line 1: expected the columns a, b, got utc, c, d"),
        (",3,", ",3,4,5", "line 3: expected 3 values"),
        (" a ", "b", "line 1: expected the columns a, b, got utc, b, b"),
        ("utc", "a", "line 1: expected column 'a' once"),
    ],
)
def test_another_form_is_refused(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    def checked() -> None:
        (tmp_path / "x.csv").write_text(TEXT.replace(old, new), encoding="utf-8")
        read_csv(tmp_path / "x.csv", ("a", "b")).numbers(("a",))

    assert f"x.csv: {complaint}" in complaint_of(checked)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(InputError, match="regular file"):
        read_csv(tmp_path / "pipe.csv")


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "none.csv").write_bytes(bytes(range(32)) * 20)
    for path in (tmp_path, tmp_path / "nowhere.csv", tmp_path / "none.csv"):
        assert complaint_of(read_csv, path).startswith(f"{path}: expected")
