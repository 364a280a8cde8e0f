"""Tables in text files, read so that each fault is reported with file, line and column.

`table_layout` finds how a file is written, pandas reads it. What was assumed, changed or left out
is in the table's `notes`, a line each.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_numeric_dtype

from bus_schemas.errors import InputError, listed
from sim_plant import Floats
from sim_plant.table_layout import MISSING, Layout, find_layout, is_date, name_and_unit, named
from sim_plant.time_stamps import parsed_stamps, stamp_columns, stamp_text, with_zone

_NS: Final = 1_000_000_000
_SENTINELS: Final = (
    *(-99.0, -999.0, -9999.0, -99999.0, -99.9, -999.9, -9999.9, -99999.9, -999.99, -9999.99),
    *(-6999.0, -7999.0),
)
"""Numbers that loggers write where a value is missing."""

_MISSING_WORDS: Final = [*MISSING, *map(str.upper, MISSING), *map(str.title, MISSING), "NaN"]
_LONGEST_HELD_S: Final = 60.0
"""A signal that has no sample for longer is refused."""


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """A table; its rows are indexed by their lines in the file, from 0.

    stamps: The time stamps as text, where the file has more columns than are named as needed.
    fields: All other columns.
    units: What the header states for some of them, beside the name or in a row of units.
    """

    path: Path
    layout: Layout
    fields: pd.DataFrame
    stamps: pd.Series
    units: dict[str, str]
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def stamp(self) -> str:
        """The column of time stamps; the first of them, if date and time stand apart."""
        return str(self.stamps.name)

    @property
    def value_columns(self) -> tuple[str, ...]:
        return tuple(self.fields.columns)

    def column(self, name: str) -> pd.Series:
        if name == self.stamp:
            return self.stamps
        if self.value_columns.count(name) > 1:
            raise InputError(
                f"{self.name}: line {self.layout.first_line}: expected column '{name}' once, "
                "got it twice"
            )
        return self.fields[name]

    def text(self, name: str) -> pd.Series:
        return self.column(name).astype(str).fillna("").str.strip()

    def unique_names(self, column: str) -> tuple[str, ...]:
        """Return the names in a column, none of which may come twice."""
        names = self.text(column)
        if names.duplicated().any():
            row = int(names.duplicated().argmax())
            raise self.error(row, column, "a name that no other line has")
        return tuple(names)

    def coordinates(self, column: str) -> pd.DataFrame:
        """Return `lat` and `lon` [degree] by the names in a column, none of which comes twice."""
        lat_deg = self.numbers(("lat",), "degrees from -90 to 90", -90.0, 90.0)
        lon_deg = self.numbers(("lon",), "degrees from -180 to 180", -180.0, 180.0)
        names = list(self.unique_names(column))
        return pd.DataFrame(np.hstack([lat_deg, lon_deg]), names, ["lat", "lon"])

    def error(self, row: int, column: str, expected: str) -> InputError:
        cell = self.column(column).iloc[row]
        got = f"{cell:.12g}" if isinstance(cell, float) else str(cell)
        return InputError(
            f"{self.name}: line {self.fields.index[row] + 1}, column '{column}': expected "
            f"{expected}, got {'nothing' if pd.isna(cell) else repr(got)}"
        )

    def numbers(
        self,
        columns: Sequence[str],
        expected: str = "a number",
        low: float = -np.inf,
        high: float = np.inf,
        *,
        empty_is_missing: bool = False,
        sentinels: bool = False,
    ) -> Floats:
        """Return columns as numbers from `low` to `high`, shape (rows, columns).

        A missing value is an error, or NaN if `empty_is_missing`; `sentinels` are such as -999.
        """
        values = np.column_stack([self._floats(name) for name in columns])
        is_missing = np.column_stack([self.column(name).isna() for name in columns])
        is_sentinel = np.zeros(0, dtype=bool)
        if sentinels and (values <= max(_SENTINELS)).any():
            is_sentinel = np.isin(values, _SENTINELS)
        if is_sentinel.any():
            words = listed([f"{one:g}" for one in np.unique(values[is_sentinel])])
            self.notes.append(f"{words} in {is_sentinel.sum():,} fields counts as missing")
            values[is_sentinel], is_missing = np.nan, is_missing | is_sentinel
        bad = ~((values >= low) & (values <= high) & np.isfinite(values))
        if empty_is_missing:
            bad &= ~is_missing
        if bad.any():
            row, column = np.argwhere(bad)[0]
            more = f" and {bad.sum() - 1:,} more such fields" if bad.sum() > 1 else ""
            raise InputError(f"{self.error(int(row), columns[column], expected)}{more}")
        return values

    def _floats(self, name: str) -> Floats:
        cells = self.column(name)
        if not is_numeric_dtype(cells):  # Some cell is no number.
            text = self.text(name).str.replace(self.layout.thousands or "\0", "", regex=False)
            cells = pd.to_numeric(text.str.replace(self.layout.decimal, ".", regex=False), "coerce")
        return cells.to_numpy(np.float64)

    def times(self, timezone: str | None, dates: str | None = None) -> pd.DatetimeIndex:
        """Return the time stamps in UTC; those without an offset are of a zone.

        `dates`: `day-first` or `month-first`, where the stamps leave it open.
        """
        stamps, notes = parsed_stamps(self.stamps, self._stamp_hint, dates, self.name)
        if stamps.isna().any():
            expected = "a time stamp such as 2013-09-08T09:15:00Z"
            raise self.error(int(stamps.isna().argmax()), self.stamp, expected)
        times, more = with_zone(pd.DatetimeIndex(stamps), timezone)
        self.notes.extend([*notes, *more])
        if times.isna().any():
            expected = (
                f"a time that the clocks of {timezone} show once; loggers that keep standard time "
                "have a zone such as Etc/GMT-1"
            )
            raise self.error(int(times.isna().argmax()), self.stamp, expected)
        return times.as_unit("ns")

    @property
    def _stamp_hint(self) -> str:
        header, units = self.layout.header, self.layout.units
        return " ".join(f"{header[at]} {units[at]}" for at in stamp_columns(self.layout))

    @property
    def is_zoned(self) -> bool:
        """Whether the time stamps, or the header, say their zone."""
        some = self.stamps.head(2000)
        stamps, _ = parsed_stamps(some, self._stamp_hint, "day-first", self.name)
        return pd.DatetimeIndex(stamps).tz is not None

    def seconds_ns(self, column: str) -> NDArray[np.int64]:
        """Return a column of two or more seconds, or times of day H:MM:SS, in ns."""
        cells = self.text(column)
        if not cells.str.contains(":").any():
            second = self.numbers((column,), "a number of seconds", -1e9, 1e9)[:, 0]
            return np.rint(second * 1e9).astype(np.int64)
        since_midnight = pd.to_timedelta(cells, errors="coerce")
        if since_midnight.isna().any():
            row = int(since_midnight.isna().argmax())
            raise self.error(row, column, "a time of day such as 12:56:40")
        return since_midnight.dt.as_unit("ns").to_numpy().astype(np.int64)

    def check_length(self) -> None:
        if len(self.fields) < 2:
            raise InputError(f"{self.name}: expected at least 2 rows, got {len(self.fields)}")

    def steady(
        self, column: str, time_ns: NDArray[np.int64], *, may_lack: bool = False
    ) -> tuple[CsvTable, NDArray[np.int64]]:
        """Return table and times, oldest first and rounded to their step within a tenth of it.

        The times of `column` are refused unless they are two or more that keep one step above 0;
        some may be missing with `may_lack`.
        """
        self.check_length()
        table = self
        if (np.diff(time_ns) < 0).all():
            fields, stamps = self.fields.iloc[::-1], self.stamps.iloc[::-1]
            table, time_ns = replace(self, fields=fields, stamps=stamps), time_ns[::-1]
            self.notes.append("the newest line was first: the order was reversed")
        # The median, so that one gap at the top of the file is not taken for its step.
        step = max(_plain_step(float(np.median(np.diff(time_ns)))), 1)
        grid = time_ns[0] + np.rint((time_ns - time_ns[0]) / step).astype(np.int64) * step
        grid += int(np.median(time_ns - grid))
        to_second = round(grid[0] / _NS) * _NS - grid[0]
        grid += to_second if abs(to_second) <= step / 10 and step % _NS == 0 else 0
        off_ns = np.abs(time_ns - grid)
        if 0 < off_ns.max() <= step / 10:
            self.notes.append(
                f"{(off_ns > 0).sum():,} of {len(grid):,} time stamps were up to "
                f"{off_ns.max() / 1e9:g} s off the step of {step / 1e9:g} s: rounded to it"
            )
            time_ns = grid
        steps = np.diff(time_ns)
        usual_ns = max(float(np.median(steps)), 1.0)
        is_late = (steps % usual_ns != 0) if may_lack else (steps != usual_ns)
        mostly = f", here mostly {usual_ns / 1e9:g} s" if usual_ns > 1.0 else ""
        table.refuse((steps <= 0) | is_late, column, f"times in one step above 0{mostly}")
        return table, time_ns

    def refuse(self, bad: NDArray[np.bool_], column: str, expected: str) -> None:
        """Name the lines after the first whose time is bad."""
        if bad.any():
            lines = listed([str(line + 1) for line in self.fields.index[1:][bad]])
            error = self.error(int(bad.argmax()) + 1, column, expected)
            raise InputError(f"{error} (all such lines: {lines})")

    def said(self) -> tuple[str, ...]:
        """Return one line on how the file was read; none, if it is of the plainest form."""
        notes = list(dict.fromkeys([*self.layout.notes, *self.notes]))
        return (f"{self.name}: {'; '.join(notes)}",) if notes else ()


def _plain_step(median_ns: float) -> int:
    """Return the step that stamps with jitter mean: 10 s of 9.999 s."""
    for unit_ns in (_NS, _NS // 1000):
        step = round(median_ns / unit_ns) * unit_ns
        if abs(step - median_ns) <= median_ns / 200.0:
            return step
    return int(median_ns)


def read_csv(
    path: Path,
    needed: Sequence[str] = (),
    *,
    header: tuple[str, ...] = (),
    texts: Collection[str] = (),
) -> CsvTable:
    """Read a table of which some columns are needed; `texts` hold names.

    Columns that are needed have these names, whatever their names in the file. `header` are the
    columns of a file that has none, separated by commas.
    """
    is_known = bool(header) and path.is_file()
    layout = (
        Layout("utf-8", ",", ".", None, header, ("",) * len(header), 0, header)
        if is_known
        else find_layout(path, needed)
    )
    names, stamps = list(layout.header), () if needed or is_known else stamp_columns(layout)
    for name in needed:
        at = named(names, name)
        assert at is not None
        names[at] = name
    as_text = {*stamps, *(at for at, name in enumerate(names) if name in texts)}
    every = range(len(names))
    options: dict[str, Any] = {
        "sep": layout.separator,
        "decimal": layout.decimal,
        "thousands": layout.thousands,
        "header": None,
        "names": every,
        "index_col": False,
        "skiprows": layout.first_line,
        "skip_blank_lines": False,
        "skipinitialspace": True,
        "keep_default_na": False,
        "na_values": {at: [""] if at in as_text else _MISSING_WORDS for at in every},
        "dtype": dict.fromkeys(as_text, str),
        "low_memory": False,
        "encoding": layout.encoding,
        "encoding_errors": "replace",
    }
    try:
        fields = pd.read_csv(path, **options)
    except pd.errors.EmptyDataError:
        fields = pd.DataFrame(columns=every)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    fields.index = pd.RangeIndex(layout.first_line, layout.first_line + len(fields))
    fields = _without_blank_rows(fields)
    text = stamp_text(layout, fields) if stamps else pd.Series(None, fields.index, dtype=str)
    text.name = names[stamps[0]] if stamps else None
    values = [at for at in every if at not in stamps]
    units = {names[at]: name_and_unit(names[at])[1] or layout.units[at] for at in values}
    fields = fields[values].set_axis([names[at] for at in values], axis=1)
    return CsvTable(path, layout, fields, text, units)


def _unreadable(path: Path, error: Exception) -> InputError:
    text = " ".join(str(getattr(error, "strerror", None) or error).split())
    if found := re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", text):
        expected = f"{found[1]} values as in the header"
        return InputError(f"{path.name}: line {found[2]}: expected {expected}, got {found[3]}")
    return InputError(f"{path}: expected a CSV file, got: {text}")


def _without_blank_rows(fields: pd.DataFrame) -> pd.DataFrame:
    """Leave out rows without any value, and comments between the rows."""
    leave_out = fields.isna().all(axis=1)
    if not is_numeric_dtype(fields[0]):
        leave_out |= fields[0].astype(str).str.startswith("#")
    return fields[~leave_out] if leave_out.any() else fields


def held_values(
    path: Path,
    time_ns: NDArray[np.int64],
    bounds: tuple[float, float],
    what: str,
    *,
    begins: pd.Timestamp,
    column: str | None = None,
    hint: str = "",
) -> tuple[Floats, tuple[str, ...]]:
    """Return the values of a file at some times, each of which holds until the next; and notes.

    The first column is the time on the file's own clock in constant steps: seconds, times of day,
    or local time stamps, of which second 0 is at `begins`. The second one, or `column`, is the
    value. A sample that is missing is that before it; the last holds for one step. `what` the file
    shall have and a `hint` are said where it does not cover the times.
    """
    table = read_csv(path)
    column = _signal_column(table, column, begins)
    if is_date(str(table.stamps.iloc[0])):
        is_zoned = table.is_zoned
        local = table.times(None if is_zoned else "UTC").tz_convert(begins.tz if is_zoned else None)
        at_ns = (local.tz_localize(None) - begins.tz_localize(None)).as_unit("ns").asi8
    else:
        at_ns = table.seconds_ns(table.stamp)
    table, at_ns = table.steady(table.stamp, at_ns, may_lack=True)
    step = int(np.median(np.diff(at_ns)))
    every_ns = np.arange(at_ns[0], at_ns[-1] + 1, step)
    values = pd.Series(_within(table, column, bounds), at_ns).reindex(every_ns)
    held = values.ffill(limit=max(int(_LONGEST_HELD_S * _NS) // step, 1))
    if held.isna().any():
        row = max(int(np.searchsorted(at_ns, every_ns[held.isna().argmax()])) - 1, 0)
        expected = f"a sample at least every {_LONGEST_HELD_S:g} s, from the first line on"
        raise table.error(row, column, expected)
    if lacking := int(values.isna().sum()):
        table.notes.append(f"missing samples of {column}: {lacking:,}: the one before was held")
    first_ns, last_ns = int(time_ns.min()), int(time_ns.max())
    begins_ns, ends_ns = int(at_ns[0]), int(at_ns[-1]) + step
    if first_ns < begins_ns or last_ns >= ends_ns:
        needs = f"seconds {first_ns / _NS:.15g} to {last_ns / _NS:.15g}"
        has = f"{begins_ns / _NS:.15g} to {ends_ns / _NS:.15g}"
        raise InputError(f"{path.name}: expected {what}, {needs}, got {has}{hint}")
    return np.asarray(held, np.float64)[(time_ns - begins_ns) // step], table.said()


def _within(table: CsvTable, column: str, bounds: tuple[float, float]) -> Floats:
    """Return values from a low to a high bound; what is beyond by rounding is clipped."""
    low, high = bounds
    slack, expected = 1e-6 * (high - low), f"a number from {low:g} to {high:g}"
    found = table.numbers((column,), expected, low - slack, high + slack, empty_is_missing=True)
    values = found[:, 0]
    beyond = (values < low) | (values > high)
    if beyond.any():
        rounded = f"values beyond {low:g} to {high:g} by rounding, clipped: {beyond.sum():,}"
        table.notes.append(rounded)
    return np.clip(values, low, high)


def _signal_column(table: CsvTable, column: str | None, begins: pd.Timestamp) -> str:
    """Return the column of a signal: the only one, that of the run's day, or that asked for."""
    columns = table.value_columns
    if column is None and len(columns) == 1:
        return columns[0]
    if column is None:  # A market's file has a column for each day.
        days = pd.to_datetime(pd.Series(columns), errors="coerce", format="mixed")
        same = [name for name, day in zip(columns, days, strict=True) if day == begins.date()]
        column = same[0] if len(same) == 1 else None
    if column not in columns:
        raise InputError(
            f"{table.name}: line 1: expected a `column` in the scenario, one of "
            f"{listed(columns)}, got {column or 'none'}"
        )
    table.notes.append(f"column {column} was taken")
    return column
