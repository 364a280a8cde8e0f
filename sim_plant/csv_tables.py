"""Tables in text files, read so that each fault is reported with file, line and column.

`table_layout` finds how a file is written, pandas reads it. What was assumed, changed or left out
is in the table's `notes`, a line each.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError, listed
from sim_plant import Floats
from sim_plant.table_layout import MISSING, Layout, find_layout, name_and_unit, named
from sim_plant.time_stamps import parsed_stamps, stamp_columns, stamp_text, with_zone

_NS: Final = 1_000_000_000
_SENTINELS: Final = (
    *(-99.0, -999.0, -9999.0, -99999.0, -99.9, -999.9, -9999.9, -99999.9, -999.99, -9999.99),
    *(-6999.0, -7999.0),
)
"""Numbers that loggers write where a value is missing."""

_LONGEST_HELD_S: Final = 60.0
"""A signal that has no sample for longer is refused."""


@dataclass(frozen=True, slots=True, eq=False)
class CsvTable:
    """A table; its rows are indexed by their lines in the file, from 0."""

    path: Path
    layout: Layout
    fields: pd.DataFrame
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def header(self) -> tuple[str, ...]:
        return self.layout.header

    @property
    def stamp(self) -> str:
        """The column of time stamps; the first of them, if date and time stand apart."""
        return self.header[stamp_columns(self.layout)[0]]

    @property
    def value_columns(self) -> tuple[str, ...]:
        """The names of all columns but those of the time stamps."""
        stamps = stamp_columns(self.layout)
        return tuple(name for at, name in enumerate(self.header) if name and at not in stamps)

    def place(self, column: str) -> int:
        """Return the place of a column, by its name with or without a unit."""
        for names in (self.header, [name_and_unit(name)[0] for name in self.header]):
            if names.count(column) > 1:
                raise InputError(
                    f"{self.name}: line {self.layout.first_line}: expected column '{column}' once, "
                    "got it twice"
                )
            if column in names:
                return names.index(column)
        found = named(self.header, column)
        assert found is not None
        return found

    def unit(self, column: str) -> str:
        """Return the unit that the header states, beside the name or in a row of units."""
        at = self.place(column)
        return name_and_unit(self.header[at])[1] or self.layout.units[at].strip("[]()")

    def is_numeric(self, columns: Sequence[str]) -> bool:
        """Whether columns have nothing but numbers and missing values."""
        kinds = [self.fields.dtypes.iloc[self.place(name)] for name in columns]
        return all(map(pd.api.types.is_numeric_dtype, kinds))

    def text(self, column: str) -> pd.Series:
        return self.fields.iloc[:, self.place(column)].astype(str).str.strip()

    def unique_names(self, column: str) -> tuple[str, ...]:
        """Return the names in a column, none of which may come twice."""
        names = tuple(self.text(column))
        repeated = pd.Index(names).duplicated()
        if repeated.any():
            raise self.error(int(repeated.argmax()), column, "a name that no other line has")
        return names

    def coordinates(self, column: str) -> pd.DataFrame:
        """Return `lat` and `lon` [degree] by the names in a column, none of which comes twice."""
        lat_deg = self.numbers(("lat",), "degrees from -90 to 90", -90.0, 90.0)
        lon_deg = self.numbers(("lon",), "degrees from -180 to 180", -180.0, 180.0)
        names = list(self.unique_names(column))
        return pd.DataFrame(np.hstack([lat_deg, lon_deg]), names, ["lat", "lon"])

    def error(self, row: int, column: str, expected: str) -> InputError:
        line = int(self.fields.index[row])
        got = self._cell(line, self.place(column))
        return InputError(
            f"{self.name}: line {line + 1}, column '{column}': expected {expected}, got '{got}'"
        )

    def _cell(self, line: int, at: int) -> str:
        """Return a cell as the file has it: what is missing in the table may be a word there."""
        with self.path.open(encoding=self.layout.encoding, errors="replace") as file:
            text = next(islice(file, line, None), "").strip("\r\n")
        separator = self.layout.separator
        cells = (
            text.split() if separator == r"\s+" else next(csv.reader([text], delimiter=separator))
        )
        return cells[at].strip() if at < len(cells) else ""

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
        cells = [self.fields.iloc[:, self.place(name)] for name in columns]
        values = np.column_stack([self._floats(one) for one in cells])
        if self.is_numeric(columns):
            is_missing = np.isnan(values)
        else:
            is_missing = np.column_stack([_is_missing(one) for one in cells])
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

    def _floats(self, cells: pd.Series) -> Floats:
        if not pd.api.types.is_numeric_dtype(cells):  # Some cell is no number.
            text = cells.astype(str).str.strip()
            if self.layout.thousands:
                text = text.str.replace(self.layout.thousands, "", regex=False)
            cells = pd.to_numeric(text.str.replace(self.layout.decimal, ".", regex=False), "coerce")
        return cells.to_numpy(np.float64)

    def times(self, timezone: str | None, dates: str | None = None) -> pd.DatetimeIndex:
        """Return the time stamps in UTC; those without an offset are of a zone.

        `dates`: `day-first` or `month-first`, where the stamps leave it open.
        """
        stamps, notes = parsed_stamps(
            stamp_text(self.layout, self.fields), self._stamp_hint(), dates, self.name
        )
        bad = stamps.isna().to_numpy()
        if bad.any():
            expected = "a time stamp such as 2013-09-08T09:15:00Z"
            raise self.error(int(bad.argmax()), self.stamp, expected)
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
    def is_zoned(self) -> bool:
        """Whether the time stamps, or the header, say their zone."""
        text = stamp_text(self.layout, self.fields).head(2000)
        stamps, _ = parsed_stamps(text, self._stamp_hint(), "day-first", self.name)
        return pd.DatetimeIndex(stamps).tz is not None

    @property
    def first_offset(self) -> timedelta:
        """The offset from UTC of the first time stamp; 0 where it says none."""
        found = re.search(
            r"([+-])(\d\d):?(\d\d)?$", str(stamp_text(self.layout, self.fields).iloc[0]).strip()
        )
        if found is None or not self.is_zoned:
            return timedelta(0)
        offset = timedelta(hours=int(found[2]), minutes=int(found[3] or 0))
        return -offset if found[1] == "-" else offset

    def _stamp_hint(self) -> str:
        columns = stamp_columns(self.layout)
        units = (self.layout.units[at] for at in columns)
        return " ".join([*(self.header[at] for at in columns), *units])

    def seconds_ns(self, column: str) -> NDArray[np.int64]:
        """Return a column of two or more seconds, or times of day H:MM:SS, in ns."""
        cells = self.fields.iloc[:, self.place(column)].astype(str)
        if cells.str.contains(":").any():
            since_midnight = pd.to_timedelta(cells.str.strip(), errors="coerce")
            if since_midnight.isna().any():
                row = int(since_midnight.isna().argmax())
                raise self.error(row, column, "a time of day such as 12:56:40")
            return since_midnight.dt.as_unit("ns").to_numpy().astype(np.int64)
        second = self.numbers((column,), "a number of seconds", -1e9, 1e9)[:, 0]
        return np.rint(second * 1e9).astype(np.int64)

    def check_length(self) -> None:
        if len(self.fields) < 2:
            raise InputError(f"{self.name}: expected at least 2 rows, got {len(self.fields)}")

    def steady(self, time_ns: NDArray[np.int64]) -> tuple[CsvTable, NDArray[np.int64]]:
        """Return table and times, oldest first and rounded to their step within a tenth of it."""
        self.check_length()
        table = self
        if (np.diff(time_ns) < 0).all():
            table, time_ns = replace(self, fields=self.fields.iloc[::-1]), time_ns[::-1]
            self.notes.append("the newest line was first: the order was reversed")
        step = _plain_step(float(np.median(np.diff(time_ns))))
        if step <= 0:
            return table, time_ns
        grid = time_ns[0] + np.rint((time_ns - time_ns[0]) / step).astype(np.int64) * step
        grid += int(np.median(time_ns - grid))
        whole = round(grid[0] / _NS) * _NS - grid[0]
        grid += whole if abs(whole) <= step / 10 and step % _NS == 0 else 0
        off_ns = np.abs(time_ns - grid)
        if 0 < off_ns.max() <= step / 10:
            self.notes.append(
                f"{(off_ns > 0).sum():,} of {len(grid):,} time stamps were up to "
                f"{off_ns.max() / 1e9:g} s off the step of {step / 1e9:g} s: rounded to it"
            )
            return table, grid
        return table, time_ns

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

    def said(self) -> tuple[str, ...]:
        """Return one line on how the file was read; none, if it is of the plainest form."""
        notes = list(dict.fromkeys([*self.layout.notes, *self.notes]))
        return (f"{self.name}: {'; '.join(notes)}",) if notes else ()


def _plain_step(median_ns: float) -> int:
    """Return the step that stamps with jitter mean: 10 s of 9.999 s."""
    for unit_ns in (_NS, _NS // 10, _NS // 100, _NS // 1000):
        step = round(median_ns / unit_ns) * unit_ns
        if step > 0 and abs(step - median_ns) <= median_ns / 200.0:
            return step
    return int(median_ns)


def _is_missing(cells: pd.Series) -> NDArray[np.bool_]:
    return (cells.isna() | cells.astype(str).str.strip().str.lower().isin(MISSING)).to_numpy()


def read_csv(
    path: Path,
    needed: Sequence[str] = (),
    *,
    header: tuple[str, ...] = (),
    texts: Collection[str] = (),
) -> CsvTable:
    """Read a table of which some columns are needed; `texts` hold names.

    `header` are the columns of a file that has none, separated by commas.
    """
    layout = (
        Layout("utf-8", ",", ".", None, header, ("",) * len(header), 0, ((*header,),), ())
        if header and path.is_file()
        else find_layout(path, needed)
    )
    columns = range(len(layout.header))
    as_text = {named(layout.header, name) for name in texts}
    if not header:
        as_text |= {*stamp_columns(layout)} if not needed else set()
    words = [*MISSING, *(word.upper() for word in MISSING), *(word.title() for word in MISSING)]
    options: dict[str, Any] = {
        "sep": layout.separator,
        "decimal": layout.decimal,
        "thousands": layout.thousands,
        "header": None,
        "names": [*columns, len(columns)],  # The last one is for what is too much.
        "index_col": False,
        "skiprows": layout.first_line,
        "skip_blank_lines": False,
        "skipinitialspace": True,
        "keep_default_na": False,
        "na_values": {at: words for at in [*columns, len(columns)] if at not in as_text},
        "dtype": {at: str for at in as_text if at is not None},
        "low_memory": False,
    }
    try:
        fields = _parsed(path, layout.encoding, options)
    except (OSError, ValueError) as error:
        got = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise InputError(f"{path}: expected a CSV file, got: {got}") from None
    fields.index = pd.RangeIndex(layout.first_line, layout.first_line + len(fields))
    more, fields = fields.iloc[:, -1].notna(), fields.iloc[:, :-1]
    if more.any():
        line = layout.first_line + int(more.to_numpy().argmax()) + 1
        expected = f"{len(columns)} values as in the header"
        raise InputError(f"{path.name}: line {line}: expected {expected}, got more")
    return CsvTable(path, layout, _without_blank_rows(fields))


def _parsed(path: Path, encoding: str, options: dict[str, Any]) -> pd.DataFrame:
    try:
        found: pd.DataFrame = pd.read_csv(path, encoding=encoding, **options)
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=options["names"])
    except UnicodeDecodeError:  # Beyond the lines from which the encoding was found.
        found = pd.read_csv(path, encoding="cp1252", **options)
    return found


def _without_blank_rows(fields: pd.DataFrame) -> pd.DataFrame:
    """Leave out rows without any value, and comments between the rows."""
    first = fields.iloc[:, 0]
    comment = pd.Series(data=False, index=fields.index)
    if not pd.api.types.is_numeric_dtype(first):
        comment = first.astype(str).str.startswith("#")
    blank = comment.copy()
    if fields.iloc[:, -1].isna().any():
        blank |= (fields.isna() | (fields == "")).all(axis=1)
    return fields[~blank] if blank.any() else fields


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
    must be, and a hint, are for errors.
    """
    table = read_csv(path)
    column = _signal_column(table, column, begins)
    if "-" in table.layout.sample[0][0][1:] or "/" in table.layout.sample[0][0]:
        local = table.times("UTC") if not table.is_zoned else table.times(None)
        zone = begins.tz if table.is_zoned else None
        clock = local.tz_convert(zone).tz_localize(None) if zone else local.tz_localize(None)
        at_ns = (clock - begins.tz_localize(None)).as_unit("ns").asi8
    else:
        at_ns = table.seconds_ns(table.stamp)
    table, at_ns = table.steady(at_ns)
    table.check_steady(table.stamp, at_ns, may_lack=True)
    low, high = bounds
    slack, expected = 1e-6 * (high - low), f"a number from {low:g} to {high:g}"
    values = table.numbers((column,), expected, low - slack, high + slack, empty_is_missing=True)[
        :, 0
    ]
    beyond = (values < low) | (values > high)
    if beyond.any():
        table.notes.append(
            f"values beyond {low:g} to {high:g} by rounding, clipped: {beyond.sum():,}"
        )
    values = np.clip(values, low, high)
    step = int(np.median(np.diff(at_ns)))
    known = ~np.isnan(values)
    held_ns = np.diff(at_ns[known], append=at_ns[-1] + step) - step
    lacking = int((held_ns // step).sum()) + int((~known[: known.argmax()]).sum())
    if lacking:
        longest_s = held_ns.max() / _NS
        if longest_s > _LONGEST_HELD_S or not known[0]:
            row = int(np.flatnonzero(known)[held_ns.argmax()]) if known[0] else 0
            expected = f"a sample at least every {_LONGEST_HELD_S:g} s, from the first line on"
            raise table.error(row, column, expected)
        table.notes.append(
            f"missing samples of {column}: {lacking:,}, for at most {longest_s:g} s: the one "
            "before was held"
        )
    first_ns, last_ns = int(time_ns.min()), int(time_ns.max())
    begins_ns, ends_ns = int(at_ns[0]), int(at_ns[-1]) + step
    if first_ns < begins_ns or last_ns >= ends_ns:
        needs = f"seconds {first_ns / _NS:.15g} to {last_ns / _NS:.15g}"
        has = f"{begins_ns / _NS:.15g} to {ends_ns / _NS:.15g}"
        raise InputError(f"{path.name}: expected {what}, {needs}, got {has}{hint}")
    found = values[known][np.searchsorted(at_ns[known], time_ns, side="right") - 1]
    return found, table.said()


def _signal_column(table: CsvTable, column: str | None, begins: pd.Timestamp) -> str:
    """Return the column of a signal: the only one, that of the run's day, or that asked for."""
    columns = table.value_columns
    if not columns:
        got = ", ".join(table.header)
        raise InputError(f"{table.name}: line 1: expected two columns, time and value, got {got}")
    if column is None and len(columns) > 1:  # A market's file has a column for each day.
        days = pd.to_datetime(pd.Series(columns), errors="coerce", format="mixed")
        same = [name for name, day in zip(columns, days, strict=True) if day == begins.date()]
        column = same[0] if len(same) == 1 else None
    elif column is None:
        return columns[0]
    if column not in columns:
        raise InputError(
            f"{table.name}: line 1: expected a `column` in the scenario, one of "
            f"{listed(columns)}, got {column or 'none'}"
        )
    table.notes.append(f"column {column} was taken")
    return column
