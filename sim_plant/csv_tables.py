"""CSV files with a header line, read so that each fault is told with file, line and column."""

import csv
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError

TIME_ACCEPTED = "accepted: ISO 8601 with Z or an offset, e.g. 2013-09-08T09:15:00Z"

_TIME_PATTERN = r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:?\d\d)"


def read_header(path: Path) -> tuple[str, ...]:
    """Return the names of the columns, after checking that they and the first row fit each other.

    Raises
    ------
    InputError
        The file cannot be read, is empty, or its first row has another width than its header.
    """
    with _open_text(path) as file:
        rows = csv.reader(file)
        try:
            header = next(rows, None)
            first = next(rows, None)
        except (csv.Error, UnicodeDecodeError) as error:
            raise unreadable(path, error) from error
    if header is None:
        raise InputError(f"{path.name}: is empty; accepted: a CSV file with a header line")
    if first is not None and len(first) != len(header):
        raise _wrong_width(path, 2, len(first), len(header))
    return tuple(name.strip() for name in header)


def check_header(path: Path, header: Sequence[str], needed: Sequence[str]) -> None:
    """Refuse a header that lacks a column which the reader needs.

    Raises
    ------
    InputError
        With the columns that are accepted and those that were found.
    """
    columns = "columns" if len(needed) > 1 else "column"
    for name in needed:
        if name not in header:
            raise InputError(
                f"{path.name}: line 1: no column '{name}';"
                f" accepted: the {columns} {', '.join(needed)}; found {', '.join(header)}"
            )


def check_no_column_twice(path: Path, columns: Sequence[str], accepted: str) -> None:
    """Refuse a header that names a column twice.

    Raises
    ------
    InputError
        With the name.
    """
    for name in columns:
        if columns.count(name) > 1:
            raise InputError(
                f"{path.name}: line 1: column '{name}' is there twice; accepted: {accepted}"
            )


def read_numbers(
    path: Path,
    header: tuple[str, ...],
    wanted: Sequence[str],
    accepted: str,
    *,
    empty_is_missing: bool = False,
) -> tuple[pd.Series, NDArray[np.float64]]:
    """Read the first column as text and the wanted columns as numbers.

    Parameters
    ----------
    path : pathlib.Path
        The file, of T rows below its header.
    header : tuple of str
        Names of all its columns, from `read_header`.
    wanted : sequence of str
        Names of N columns; the values of others are not looked at.
    accepted : str
        What a value must be, for the error message, e.g. `a number in W/m2`.
    empty_is_missing : bool, default False
        Whether an empty field is a missing value instead of an error.

    Returns
    -------
    first : pandas.Series of str, length T
    values : numpy.ndarray, shape (T, N)
        NaN where a value is missing.

    Raises
    ------
    InputError
        There are fewer than two rows, a row has another width than the header, or a wanted value
        is no number or, unless `empty_is_missing`, empty.
    """
    try:
        table = pd.read_csv(
            path,
            header=0,
            names=list(header),
            dtype={header[0]: str} | dict.fromkeys(wanted, np.float64),
            index_col=False,
            skip_blank_lines=False,
            encoding="utf-8-sig",
            low_memory=False,
        )
    except (OSError, ValueError) as error:
        # pandas does not say where: look again, field by field.
        bad = _first_bad_field(path, header, wanted, accepted, empty_is_missing)
        raise bad or unreadable(path, error) from error
    values = table[list(wanted)].to_numpy()
    if len(table) < 2:
        raise InputError(f"{path.name}: {len(table)} rows below the header; accepted: at least 2")
    if np.isnan(values).any():
        bad = _first_bad_field(path, header, wanted, accepted, empty_is_missing)
        if bad is not None:
            raise bad
    return table[header[0]], values


def named_rows(path: Path, needed: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Return line number and fields (by column name) of each row of a small file.

    Raises
    ------
    InputError
        A needed column is absent, or a row has another width than the header.
    """
    header = read_header(path)
    check_header(path, header, needed)
    rows = []
    for line, fields in _rows_below_header(path):
        if len(fields) != len(header):
            raise _wrong_width(path, line, len(fields), len(header))
        rows.append((line, {k: v.strip() for k, v in zip(header, fields, strict=True)}))
    return rows


def parse_times(path: Path, column: str, stamps: pd.Series) -> pd.DatetimeIndex:
    """Turn the text of time stamps into UTC.

    Raises
    ------
    InputError
        One is not ISO 8601 with `Z` or an offset: a guess of the zone would move the sun.
    """
    well_formed = stamps.str.fullmatch(_TIME_PATTERN).fillna(False).to_numpy(dtype=bool)
    times = pd.to_datetime(
        stamps.where(well_formed), utc=True, format="ISO8601", errors="coerce"
    ).dt.as_unit("ns")
    bad = np.flatnonzero(times.isna())
    if bad.size:
        stamp = stamps.iloc[bad[0]]
        found = shown("" if pd.isna(stamp) else str(stamp))
        raise InputError(
            f"{path.name}: line {bad[0] + 2}, column '{column}': {found}; {TIME_ACCEPTED}"
        )
    return pd.DatetimeIndex(times).rename(None)


def check_increasing(
    time_ns: NDArray[np.int64], place: Callable[[int], str], first_line: int = 2
) -> None:
    """Refuse time stamps that repeat or go back.

    Parameters
    ----------
    time_ns : numpy.ndarray, shape (T,)
        The time stamps [ns].
    place : callable
        Says where a row stands and what was found there, for the error message.
    first_line : int, default 2
        Line of the first row.

    Raises
    ------
    InputError
        With the first that does.
    """
    step_ns = np.diff(time_ns)
    bad = np.flatnonzero(step_ns <= 0)
    if bad.size:
        raise InputError(
            f"{place(int(bad[0]) + 1)} {_jump(step_ns, bad[0], first_line)};"
            " accepted: each time stamp later than the one before"
        )


def check_steady(
    time_ns: NDArray[np.int64], place: Callable[[int], str], first_line: int = 2
) -> None:
    """Refuse time stamps that do not keep one step above zero.

    Parameters
    ----------
    time_ns, place, first_line
        As in `check_increasing`.

    Raises
    ------
    InputError
        With the first that does not.
    """
    step_ns = np.diff(time_ns)
    # The median, so that one gap at the top of the file is not taken for its step.
    usual_ns = float(np.median(step_ns))
    bad = np.flatnonzero((step_ns <= 0) | (step_ns != usual_ns))
    if bad.size:
        accepted = f"one step of {usual_ns / 1e9:g} s" if usual_ns > 0.0 else "one step above 0 s"
        raise InputError(
            f"{place(int(bad[0]) + 1)} {_jump(step_ns, bad[0], first_line)};"
            f" accepted: {accepted} throughout"
        )


def number(text: str) -> float:
    """Return the value of a field, NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def shown(text: str) -> str:
    """Say what stands in a field, for an error message."""
    return f"found '{text}'" if text.strip() else "found an empty field"


def unreadable(path: Path, error: Exception) -> InputError:
    """Say in one line why a file cannot be read."""
    if isinstance(error, OSError):
        reason = error.strerror or type(error).__name__
    else:
        reason = " ".join(str(error).split())
    return InputError(f"{path}: cannot be read: {reason}; accepted: a CSV file in UTF-8")


def _first_bad_field(
    path: Path,
    header: tuple[str, ...],
    wanted: Sequence[str],
    accepted: str,
    empty_is_missing: bool,
) -> InputError | None:
    """Say which field keeps the file from being a table of numbers; None if none does."""
    columns = [(name, header.index(name, 1)) for name in wanted]
    for line, fields in _rows_below_header(path):
        if len(fields) != len(header):
            return _wrong_width(path, line, len(fields), len(header))
        for name, column in columns:
            text = fields[column]
            if math.isnan(number(text)) and (text.strip() or not empty_is_missing):
                return InputError(
                    f"{path.name}: line {line}, column '{name}': {shown(text)};"
                    f" accepted: {accepted}"
                )
    return None


def _rows_below_header(path: Path) -> Iterator[tuple[int, list[str]]]:
    with _open_text(path) as file:
        rows = csv.reader(file)
        try:
            next(rows, None)
            for fields in rows:
                yield rows.line_num, fields
        except (csv.Error, UnicodeDecodeError) as error:
            raise unreadable(path, error) from error


def _open_text(path: Path) -> TextIO:
    try:
        # A spreadsheet may have put a byte order mark first.
        return path.open(encoding="utf-8-sig", newline="")
    except OSError as error:
        raise unreadable(path, error) from error


def _jump(step_ns: NDArray[np.int64], row: np.intp, first_line: int) -> str:
    step_s = float(step_ns[row]) / 1e9
    before = f"line {first_line + int(row)}"
    if step_s == 0.0:
        return f"repeats {before}"
    if step_s < 0.0:
        return f"goes back {-step_s:g} s from {before}"
    return f"is {step_s:g} s after {before}"


def _wrong_width(path: Path, line: int, found: int, expected: int) -> InputError:
    return InputError(
        f"{path.name}: line {line}: {found} fields; accepted: {expected}, as in the header"
    )
