"""CSV files, read so that each fault is reported with file, line and column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError, listed
from sim_plant import Floats

_MISSING: Final = ("", "nan", "na", "null")
"""What programs write where a value is missing, in lower case."""

_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """The text of a CSV file; the rows are indexed by their lines, from 0."""

    name: str
    header: tuple[str, ...]
    fields: pd.DataFrame

    def text(self, column: str) -> pd.Series:
        if self.header.count(column) > 1:
            raise InputError(f"{self.name}: line 1: expected column '{column}' once, got it twice")
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

    def coordinates(self, column: str) -> pd.DataFrame:
        """Return `lat` and `lon` [degree] by the names in a column, none of which comes twice."""
        self.check_header((column, "lat", "lon"))
        lat_deg = self.numbers(("lat",), "degrees from -90 to 90", -90.0, 90.0)
        lon_deg = self.numbers(("lon",), "degrees from -180 to 180", -180.0, 180.0)
        names = list(self.unique_names(column))
        return pd.DataFrame(np.hstack([lat_deg, lon_deg]), names, ["lat", "lon"])

    def error(self, row: int, column: str, expected: str) -> InputError:
        text = self.text(column)
        place = f"{self.name}: line {int(text.index[row]) + 1}, column '{column}'"
        return InputError(f"{place}: expected {expected}, got '{text.iloc[row]}'")

    def check_header(self, needed: Sequence[str]) -> None:
        """Refuse a header that lacks a column which the reader needs."""
        if not set(needed) <= set(self.header):
            raise InputError(
                f"{self.name}: line 1: expected the columns {', '.join(needed)}, got "
                f"{', '.join(self.header)}"
            )

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

        An empty field and `NaN` are an error, or NaN if `empty_is_missing`.
        """
        found = [pd.to_numeric(self.text(name), errors="coerce") for name in columns]
        values = np.column_stack(found).astype(np.float64)
        bad = ~((values >= low) & (values <= high) & np.isfinite(values))
        if empty_is_missing:
            texts = [self.text(name).str.strip().str.lower() for name in columns]
            bad &= ~np.column_stack([text.isin(_MISSING) for text in texts])
        if bad.any():
            row, column = np.argwhere(bad)[0]
            more = f" and {bad.sum() - 1:,} more such fields" if bad.sum() > 1 else ""
            raise InputError(f"{self.error(int(row), columns[column], expected)}{more}")
        return values

    def times(self, column: str) -> pd.DatetimeIndex:
        """Return the time stamps of a column in UTC.

        They are ISO 8601 with `Z` or an offset: a guess of the zone would move the sun.
        """
        stamps = self.text(column)
        zoned = stamps.where(stamps.str.contains(r"(?:Z|[+-]\d\d:?\d\d)$"))
        times = pd.to_datetime(zoned, utc=True, format="ISO8601", errors="coerce")
        if times.isna().any():
            expected = "ISO 8601 with Z or an offset, such as 2013-09-08T09:15:00Z"
            raise self.error(int(times.isna().argmax()), column, expected)
        return pd.DatetimeIndex(times.dt.as_unit("ns")).rename(None)

    def seconds_ns(self, column: str) -> NDArray[np.int64]:
        """Return a column of two or more seconds that keep one step, in ns; see `check_steady`."""
        second = self.numbers((column,), "a number of seconds", -1e9, 1e9)[:, 0]
        time_ns: NDArray[np.int64] = np.rint(second * 1e9).astype(np.int64)
        self.check_steady(column, time_ns)
        return time_ns

    def check_length(self) -> None:
        if len(self.fields) < 2:
            raise InputError(f"{self.name}: expected at least 2 rows, got {len(self.fields)}")

    def check_steady(
        self, column: str, time_ns: NDArray[np.int64], *, may_lack: bool = False
    ) -> None:
        """Refuse the times of a column unless they are two or more that keep one step above 0.

        Times may be missing with `may_lack`.
        """
        self.check_length()
        step_ns = np.diff(time_ns)
        # The median, so that one gap at the top of the file is not taken for its step.
        usual_ns = max(float(np.median(step_ns)), 1.0)
        is_late = (step_ns % usual_ns != 0) if may_lack else (step_ns != usual_ns)
        expected = "times in one step above 0"
        if usual_ns > 1.0:
            expected += f", here mostly {usual_ns / 1e9:g} s"
        self._refuse((step_ns <= 0) | is_late, column, expected)

    def check_ascending(self, column: str, time_ns: NDArray[np.int64]) -> None:
        """Refuse the times of a column unless each is later than the one before it."""
        self._refuse(np.diff(time_ns) <= 0, column, "a time after that of the line before")

    def _refuse(self, bad: NDArray[np.bool_], column: str, expected: str) -> None:
        """Name the lines after the first whose time is bad."""
        if bad.any():
            lines = listed([str(line + 1) for line in self.fields.index[1:][bad]])
            error = self.error(int(bad.argmax()) + 1, column, expected)
            raise InputError(f"{error} (all such lines: {lines})")


def read_csv(path: Path, header: tuple[str, ...] = ()) -> CsvTable:
    """Read a CSV file; its first line is the header unless that is given."""
    if path.exists() and not path.is_file():  # A pipe would be waited for.
        raise InputError(f"{path}: expected a CSV file in UTF-8, got no regular file")
    if path.exists() and not path.stat().st_size:
        raise InputError(f"{path}: expected a CSV file, got an empty one")
    try:
        # A spreadsheet may have put a byte order mark first.
        text = path.read_text(encoding="utf-8-sig").rstrip("\r\n")
        fields = pd.read_csv(
            StringIO(text), header=None, dtype=str, keep_default_na=False, skip_blank_lines=False
        )
    except (OSError, ValueError) as error:
        got = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise InputError(f"{path}: expected a CSV file in UTF-8, got: {got}") from None
    names = header or tuple(name.strip() for name in fields.iloc[0])
    return CsvTable(path.name, names, fields if header else fields.iloc[1:])


def held_values(
    path: Path,
    time_ns: NDArray[np.int64],
    bounds: tuple[float, float],
    what: str,
    hint: str = "",
) -> Floats:
    """Return the values of a file at some times: each one holds until the next.

    The first column is the time on the file's own clock [s], in constant steps, the second one the
    value. The last value holds for one step. `what` the file must be, and a hint, are for errors.
    """
    table = read_csv(path)
    if len(table.header) != 2:
        got = len(table.header)
        raise InputError(f"{path.name}: line 1: expected two columns, seconds and value, got {got}")
    clock, value = table.header
    low, high = bounds
    values = table.numbers((value,), f"a number from {low:g} to {high:g}", low, high)[:, 0]
    at_ns = table.seconds_ns(clock)
    first_ns, last_ns = int(time_ns.min()), int(time_ns.max())
    begins_ns, ends_ns = int(at_ns[0]), int(2 * at_ns[-1] - at_ns[-2])
    if first_ns < begins_ns or last_ns >= ends_ns:
        needs = f"seconds {first_ns / _NS:.15g} to {last_ns / _NS:.15g}"
        has = f"{begins_ns / _NS:.15g} to {ends_ns / _NS:.15g}"
        raise InputError(f"{path.name}: expected {what}, {needs}, got {has}{hint}")
    return values[np.searchsorted(at_ns, time_ns, side="right") - 1]
