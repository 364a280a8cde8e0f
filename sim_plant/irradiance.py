"""Measured irradiance: one time series of GHI for each sensor, and where the sensors stand."""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bus_schemas.errors import InputError

GHI_MIN_WM2 = -10.0
GHI_MAX_WM2 = 2000.0

# Even a dull day exceeds this many W/m^2, and no sensor on Earth reaches as many kW/m^2.
_KILOWATT_BELOW = 2.0

_TIME_PATTERN = r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:?\d\d)"
_TIME_ACCEPTED = "accepted: ISO 8601 with Z or an offset, e.g. 2013-09-08T09:15:00Z"
_GHI_ACCEPTED = "accepted: a number in W/m2"
_POSITION_LIMITS = {"lat": 90.0, "lon": 180.0}


@dataclass(frozen=True, slots=True, eq=False)
class Irradiance:
    """GHI of N sensors at T time stamps.

    Attributes
    ----------
    times : pandas.DatetimeIndex, length T
        UTC, with time zone, strictly increasing with one constant step.
    ghi_wm2 : numpy.ndarray, shape (T, N)
        Global horizontal irradiance [W/m^2], never negative.
    sensors : tuple of str
        Names of the N sensors.
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates of the sensors [degree], north and east positive.
    """

    times: pd.DatetimeIndex
    ghi_wm2: NDArray[np.float64]
    sensors: tuple[str, ...]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]


def read_measured_ghi(
    ghi_csv: Path, positions_csv: Path, stations: Sequence[str] | None = None
) -> Irradiance:
    """Read measured GHI and the coordinates of the sensors from two CSV files.

    The first column of `ghi_csv`, whatever its header, is the time stamp: ISO 8601 with `Z` or an
    offset from UTC (`2010-04-01T05:00:00-10:00`). A time stamp without either is refused, since a
    guess of the time zone would move the sun. Every other column is one sensor, named by the
    header, in W/m^2. `positions_csv` has the columns `station`, `lat` and `lon` [degree]; others
    are not read. Both files are UTF-8 with a header line.

    Pyranometers read a little below zero at night. Values from -10 to 0 W/m^2 are set to 0; a
    lower value is an error. No value is ever filled in.

    Parameters
    ----------
    ghi_csv : pathlib.Path
        The measurements.
    positions_csv : pathlib.Path
        The coordinates.
    stations : sequence of str, optional
        The sensors wanted, in this order. By default all columns of `ghi_csv`. Values of other
        columns are not checked.

    Returns
    -------
    Irradiance
        All time stamps of the file.

    Raises
    ------
    InputError
        A file cannot be read; a station has no column or no position, or has two; a value is
        empty, not a number or out of range; the file seems to hold kW/m^2; a time stamp is not as
        described, repeats, goes back, or does not keep the step of the file.
    """
    header = _header(ghi_csv)
    wanted = _wanted_columns(ghi_csv, header, stations)
    lat_deg, lon_deg = _read_positions(positions_csv, wanted)
    stamps, ghi_wm2 = _read_table(ghi_csv, header, wanted)
    _check_values(ghi_csv, ghi_wm2, wanted)
    times = _parse_times(ghi_csv, header[0], stamps)
    return Irradiance(times, np.maximum(ghi_wm2, 0.0), wanted, lat_deg, lon_deg)


def window(
    irradiance: Irradiance, start: pd.Timestamp, duration_s: float, source: str
) -> Irradiance:
    """Cut out the time stamps from `start` to just before `start + duration_s`.

    Parameters
    ----------
    irradiance : Irradiance
        What to cut from.
    start : pandas.Timestamp
        First instant of the window, with time zone.
    duration_s : float
        Length of the window [s].
    source : str
        What the irradiance was read from, for the error message.

    Returns
    -------
    Irradiance
        The window. A `start` between two time stamps begins with the later one.

    Raises
    ------
    InputError
        The start has no time zone, the duration is not above 0, the window is not wholly inside
        what the irradiance covers, or it lies between two time stamps.
    """
    if start.tzinfo is None:
        raise InputError(f"start: {start.isoformat()} has no time zone; {_TIME_ACCEPTED}")
    if not (math.isfinite(duration_s) and duration_s > 0.0):
        raise InputError(f"duration: {duration_s:g} s; accepted: above 0 s")
    times = irradiance.times
    step = times[1] - times[0]
    end = start + pd.Timedelta(duration_s, unit="s")
    if start < times[0] or end > times[-1] + step:
        raise InputError(
            f"{source}: does not cover {_iso(start)} to {_iso(end)};"
            f" it covers {_iso(times[0])} to {_iso(times[-1] + step)}"
        )
    rows = slice(times.searchsorted(start), times.searchsorted(end))
    if rows.start == rows.stop:
        raise InputError(
            f"{source}: has no time stamp from {_iso(start)} to {_iso(end)};"
            f" its step is {step.total_seconds():g} s"
        )
    return Irradiance(
        times[rows],
        irradiance.ghi_wm2[rows],
        irradiance.sensors,
        irradiance.lat_deg,
        irradiance.lon_deg,
    )


def _header(path: Path) -> tuple[str, ...]:
    """Names of the columns, after checking that they and the first row fit each other."""
    with _open_text(path) as file:
        rows = csv.reader(file)
        try:
            header = next(rows, None)
            first = next(rows, None)
        except (csv.Error, UnicodeDecodeError) as error:
            raise _unreadable(path, error) from error
    if header is None:
        raise InputError(f"{path.name}: is empty; accepted: a CSV file with a header line")
    if first is not None and len(first) != len(header):
        raise _wrong_width(path, 2, len(first), len(header))
    return tuple(name.strip() for name in header)


def _wanted_columns(
    path: Path, header: tuple[str, ...], stations: Sequence[str] | None
) -> tuple[str, ...]:
    columns = header[1:]
    wanted = columns if stations is None else tuple(stations)
    if not wanted:
        raise InputError(f"{path.name}: line 1: no station; accepted: at least one column of GHI")
    for name in columns:
        if columns.count(name) > 1:
            raise InputError(
                f"{path.name}: line 1: column '{name}' is there twice; accepted: one per station"
            )
    for name in wanted:
        if name not in columns:
            raise InputError(
                f"{path.name}: line 1: no column for station '{name}';"
                f" its stations are {', '.join(columns)}"
            )
        if wanted.count(name) > 1:
            raise InputError(f"stations: '{name}' is there twice; accepted: each station once")
    return wanted


def _read_positions(
    path: Path, stations: tuple[str, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    positions: dict[str, tuple[float, float]] = {}
    for line, row in _position_rows(path):
        name = row["station"]
        if name not in stations:
            continue
        if name in positions:
            raise InputError(
                f"{path.name}: line {line}: station '{name}' is there twice;"
                " accepted: one position per station"
            )
        positions[name] = (_degrees(path, line, row, "lat"), _degrees(path, line, row, "lon"))
    for name in stations:
        if name not in positions:
            raise InputError(
                f"{path.name}: no position for station '{name}'; accepted: a line for each station"
            )
    degrees = np.array([positions[name] for name in stations])
    return degrees[:, 0], degrees[:, 1]


def _position_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Line number and fields (by column name) of each row of the positions file."""
    header = _header(path)
    for name in ("station", *_POSITION_LIMITS):
        if name not in header:
            raise InputError(
                f"{path.name}: line 1: no column '{name}';"
                f" accepted: the columns station, lat, lon; found {', '.join(header)}"
            )
    rows = []
    for line, fields in _rows_below_header(path):
        if len(fields) != len(header):
            raise _wrong_width(path, line, len(fields), len(header))
        rows.append((line, {k: v.strip() for k, v in zip(header, fields, strict=True)}))
    return rows


def _degrees(path: Path, line: int, row: dict[str, str], column: str) -> float:
    limit = _POSITION_LIMITS[column]
    value = _number(row[column])
    if not abs(value) <= limit:
        raise InputError(
            f"{path.name}: line {line}, column '{column}': {_shown(row[column])};"
            f" accepted: degrees from -{limit:g} to {limit:g}"
        )
    return value


def _read_table(
    path: Path, header: tuple[str, ...], wanted: tuple[str, ...]
) -> tuple[pd.Series, NDArray[np.float64]]:
    """Text of the time stamps, and the wanted columns as numbers."""
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
        raise _first_bad_field(path, header, wanted) or _unreadable(path, error) from error
    values = table[list(wanted)].to_numpy()
    if len(table) < 2:
        raise InputError(f"{path.name}: {len(table)} rows below the header; accepted: at least 2")
    if np.isnan(values).any():
        bad = _first_bad_field(path, header, wanted)
        raise bad or InputError(f"{path.name}: has an empty value; {_GHI_ACCEPTED}")
    return table[header[0]], values


def _first_bad_field(
    path: Path, header: tuple[str, ...], wanted: tuple[str, ...]
) -> InputError | None:
    """Say which field keeps the file from being a table of numbers; None if none does."""
    columns = [(name, header.index(name, 1)) for name in wanted]
    for line, fields in _rows_below_header(path):
        if len(fields) != len(header):
            return _wrong_width(path, line, len(fields), len(header))
        for name, column in columns:
            if math.isnan(_number(fields[column])):
                found = _shown(fields[column])
                return InputError(
                    f"{path.name}: line {line}, column '{name}': {found}; {_GHI_ACCEPTED}"
                )
    return None


def _check_values(path: Path, ghi_wm2: NDArray[np.float64], wanted: tuple[str, ...]) -> None:
    bad = np.argwhere((ghi_wm2 < GHI_MIN_WM2) | (ghi_wm2 > GHI_MAX_WM2))
    if bad.size:
        row, column = bad[0]
        raise InputError(
            f"{path.name}: line {row + 2}, column '{wanted[column]}': found"
            f" '{ghi_wm2[row, column]:g}'; accepted: {GHI_MIN_WM2:g} to {GHI_MAX_WM2:g} W/m2"
        )
    largest = float(ghi_wm2.max())
    if 0.0 < largest < _KILOWATT_BELOW:
        raise InputError(
            f"{path.name}: the largest value is {largest:g}, so the unit seems to be kW/m2;"
            f" accepted: W/m2, with a maximum of at least {_KILOWATT_BELOW:g}"
        )


def _parse_times(path: Path, column: str, stamps: pd.Series) -> pd.DatetimeIndex:
    well_formed = stamps.str.fullmatch(_TIME_PATTERN).fillna(False).to_numpy(dtype=bool)
    times = pd.to_datetime(
        stamps.where(well_formed), utc=True, format="ISO8601", errors="coerce"
    ).dt.as_unit("ns")
    bad = np.flatnonzero(times.isna())
    if bad.size:
        stamp = stamps.iloc[bad[0]]
        found = _shown("" if pd.isna(stamp) else str(stamp))
        raise InputError(
            f"{path.name}: line {bad[0] + 2}, column '{column}': {found}; {_TIME_ACCEPTED}"
        )
    _check_steps(path, column, stamps, times)
    return pd.DatetimeIndex(times).rename(None)


def _check_steps(path: Path, column: str, stamps: pd.Series, times: pd.Series) -> None:
    step_s = times.diff().dt.total_seconds().to_numpy()[1:]
    # The median, so that one gap at the top of the file is not taken for its step.
    usual_s = float(np.median(step_s))
    bad = np.flatnonzero((step_s <= 0.0) | (step_s != usual_s))
    if not bad.size:
        return
    row = bad[0] + 1
    line = row + 2
    if step_s[row - 1] == 0.0:
        what = f"repeats line {line - 1}"
    elif step_s[row - 1] < 0.0:
        what = f"goes back {-step_s[row - 1]:g} s from line {line - 1}"
    else:
        what = f"is {step_s[row - 1]:g} s after line {line - 1}"
    accepted = f"one step of {usual_s:g} s" if usual_s > 0.0 else "one step above 0 s"
    raise InputError(
        f"{path.name}: line {line}, column '{column}': {_shown(str(stamps.iloc[row]))} {what};"
        f" accepted: {accepted} throughout"
    )


def _rows_below_header(path: Path) -> Iterator[tuple[int, list[str]]]:
    with _open_text(path) as file:
        rows = csv.reader(file)
        try:
            next(rows, None)
            for fields in rows:
                yield rows.line_num, fields
        except (csv.Error, UnicodeDecodeError) as error:
            raise _unreadable(path, error) from error


def _open_text(path: Path) -> TextIO:
    try:
        # A spreadsheet may have put a byte order mark first.
        return path.open(encoding="utf-8-sig", newline="")
    except OSError as error:
        raise _unreadable(path, error) from error


def _number(text: str) -> float:
    """Value of a field, NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _shown(text: str) -> str:
    return f"found '{text}'" if text.strip() else "found an empty field"


def _iso(time: pd.Timestamp) -> str:
    return time.tz_convert("UTC").isoformat().replace("+00:00", "Z")


def _wrong_width(path: Path, line: int, found: int, expected: int) -> InputError:
    return InputError(
        f"{path.name}: line {line}: {found} fields; accepted: {expected}, as in the header"
    )


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, OSError):
        reason = error.strerror or type(error).__name__
    else:
        reason = " ".join(str(error).split())
    return InputError(f"{path}: cannot be read: {reason}; accepted: a CSV file in UTF-8")
