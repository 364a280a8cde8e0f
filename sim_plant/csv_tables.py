"""CSV files, read so that each fault is reported with file, line and column."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from sim_plant import Floats

_TIME_PATTERN: Final = r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:?\d\d)"


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """The text of a CSV file with a header line; the rows are indexed by their lines, from 0."""

    name: str
    header: tuple[str, ...]
    fields: pd.DataFrame

    def text(self, column: str) -> pd.Series:
        return self.fields[self.header.index(column)]

    def names(self, column: str) -> tuple[str, ...]:
        """Return the names in a column, without spaces around them."""
        return tuple(self.text(column).str.strip())

    def unique_names(self, column: str) -> tuple[str, ...]:
        """Return the names in a column, none of which may come twice."""
        names = self.names(column)
        repeated = pd.Index(names).duplicated()
        if repeated.any():
            raise self.error(int(repeated.argmax()), column, "a name that no other line has")
        return names

    def coordinates(self) -> tuple[Floats, Floats]:
        """Return the columns `lat` and `lon` [degree]."""
        lat_deg = self.numbers(("lat",), "degrees from -90 to 90", -90.0, 90.0)
        lon_deg = self.numbers(("lon",), "degrees from -180 to 180", -180.0, 180.0)
        return lat_deg[:, 0], lon_deg[:, 0]

    def picked(self, rows: Sequence[int]) -> CsvTable:
        return CsvTable(self.name, self.header, self.fields.iloc[list(rows)])

    def error(self, row: int, column: str, expected: str) -> InputError:
        text = self.text(column)
        place = f"{self.name}: line {int(text.index[row]) + 1}, column '{column}'"
        return InputError(f"{place}: expected {expected}, got '{text.iloc[row]}'")

    def check_header(self, needed: Sequence[str]) -> None:
        """Refuse a header that lacks a column which the reader needs."""
        if missing := [name for name in needed if name not in self.header]:
            raise InputError(
                f"{self.name}: line 1: expected the columns {', '.join(needed)}, got "
                f"{', '.join(self.header)} without {', '.join(missing)}"
            )

    def check_no_column_twice(self) -> None:
        for name in self.header[1:]:
            if self.header[1:].count(name) > 1:
                raise InputError(
                    f"{self.name}: line 1: expected column '{name}' once, got it twice"
                )

    def check_length(self) -> None:
        if len(self.fields) < 2:
            raise InputError(f"{self.name}: expected at least 2 rows, got {len(self.fields)}")

    def numbers(
        self,
        columns: Sequence[str],
        expected: str = "a number",
        low: float = -np.inf,
        high: float = np.inf,
        *,
        empty_is_missing: bool = False,
    ) -> Floats:
        """Return columns as numbers from `low` to `high`, shape (rows, columns).

        An empty field is an error, or NaN if `empty_is_missing`.
        """
        found = [pd.to_numeric(self.text(name), errors="coerce") for name in columns]
        values = np.column_stack(found).astype(np.float64)
        bad = ~((values >= low) & (values <= high) & np.isfinite(values))
        if empty_is_missing:
            empty = np.column_stack([self.text(name).str.strip() == "" for name in columns])
            bad &= ~empty
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise self.error(int(row), columns[column], expected)
        return values

    def times(self, column: str) -> pd.DatetimeIndex:
        """Return the time stamps of a column in UTC, two or more.

        They are ISO 8601 with `Z` or an offset: a guess of the zone would move the sun.
        """
        self.check_length()
        stamps = self.text(column)
        well_formed = stamps.str.fullmatch(_TIME_PATTERN)
        times = pd.to_datetime(
            stamps.where(well_formed), utc=True, format="ISO8601", errors="coerce"
        ).dt.as_unit("ns")
        bad = np.flatnonzero(times.isna())
        if bad.size:
            expected = "ISO 8601 with Z or an offset, such as 2013-09-08T09:15:00Z"
            raise self.error(int(bad[0]), column, expected)
        return pd.DatetimeIndex(times).rename(None)

    def seconds_ns(self, column: str) -> NDArray[np.int64]:
        """Return a column of two or more seconds that keep one step, in ns."""
        self.check_length()
        second = self.numbers((column,), "a number of seconds", -1e9, 1e9)[:, 0]
        time_ns: NDArray[np.int64] = np.rint(second * 1e9).astype(np.int64)
        self.check_steady(column, time_ns)
        return time_ns

    def check_steady(self, column: str, time_ns: NDArray[np.int64]) -> None:
        """Refuse times, of which a column speaks, that do not keep one step above zero."""
        step_ns = np.diff(time_ns)
        # The median, so that one gap at the top of the file is not taken for its step.
        usual_ns = float(np.median(step_ns))
        bad = np.flatnonzero((step_ns <= 0) | (step_ns != usual_ns))
        if bad.size:
            step = f"{usual_ns / 1e9:g} s" if usual_ns > 0.0 else "one step above 0 s"
            row = int(bad[0]) + 1
            raise self.error(row, column, f"a time {step} after that of the line before")


def read_csv(path: Path) -> CsvTable:
    try:
        # A spreadsheet may have put a byte order mark first.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: expected a CSV file, got: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8, got byte {error.start} that is not") from None
    fields = text_fields(text, path.name)
    header = tuple(name.strip() for name in fields.iloc[0])
    return CsvTable(path.name, header, fields.iloc[1:])


def text_fields(text: str, name: str) -> pd.DataFrame:
    """Return the text of all fields; each line must have as many as the first."""
    try:
        rows = list(csv.reader(StringIO(text.rstrip("\r\n"))))
    except csv.Error as error:
        raise InputError(f"{name}: expected a CSV file, got: {error}") from None
    if not rows:
        raise InputError(f"{name}: expected a CSV file with a header line, got nothing")
    if len(rows[0]) == 1 and (other := re.search(r"[;\t]", rows[0][0])):
        got = "semicolons" if other[0] == ";" else "tabs"
        raise InputError(f"{name}: line 1: expected commas between the fields, got {got}")
    for line, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise InputError(
                f"{name}: line {line}: expected {len(rows[0])} fields, as in line 1, got {len(row)}"
            )
    return pd.DataFrame(rows)
