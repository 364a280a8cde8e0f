"""Daily files of the NREL Oahu Solar Measurement Grid, as they come from the archive.

One file for each day, `YYYYMMDD.txt`, alone or in the month's archive `YYYYMM.zip`: no header, a
line each second from 05:00:00 to 20:00:00 Hawaii Standard Time (UTC-10 all the year), 23 fields
separated by commas: second, year, day of the year, hour and minute (500 is 05:00), then the W/m^2
of 19 sensors, -99999 where a value is missing [1]_. Two of the 19 are tilted and are left out:
DH1T and AP6T. That leaves the 17 horizontal sensors of the paper. An eighteenth, AP2, is not among
these fields: it was logged every 3 seconds, to files of their own, which have the same names but
7 fields.

.. [1] M. Sengupta and A. Andreas, "Oahu Solar Measurement Grid (1-Year Archive)", NREL report
   DA-5500-56506, 2010, doi:10.5439/1052451
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import date, timedelta, timezone
from pathlib import Path
from typing import Final
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from sim_plant.csv_tables import CsvTable, text_fields
from sim_plant.gap_filling import fill_from_neighbours
from sim_plant.irradiance import Irradiance, check_ghi, check_stations, read_positions

MISSING: Final = -99999.0

_SENSORS: Final = (
    *("DH3", "DH4", "DH5", "DH10", "DH11", "DH9", "DH2", "DH1", "DH1T", "AP6", "AP6T"),
    *("AP1", "AP3", "AP5", "AP4", "AP7", "DH6", "DH7", "DH8"),
)
_TIME_FIELDS: Final = ("second", "year", "day of year", "hour and minute")
_FIELDS: Final = (*_TIME_FIELDS, *_SENSORS)
_TILTED: Final = ("DH1T", "AP6T")
HORIZONTAL: Final = tuple(name for name in _SENSORS if name not in _TILTED)
"""The 17 horizontal sensors, in the order of their fields."""

TIMEZONE: Final = timezone(-timedelta(hours=10), "HST")
_ACCEPTED: Final = "YYYYMMDD.txt, or YYYYMM.zip that holds it"


def read_day(
    folder: Path,
    day: date,
    positions_csv: Path,
    stations: Sequence[str] | None = None,
    most_missing: float | None = None,
) -> Irradiance:
    """Read one day, in Hawaii, and see to its missing values.

    Values from -10 to 0 W/m^2, which the sensors show at night, are set to 0. By default all 17
    horizontal sensors are read, and a missing value is an error. A sensor of which a larger share
    of the day than `most_missing` is missing is left out; what is missing of the others is filled
    from their neighbours among the sensors that are used.
    """
    wanted = HORIZONTAL if stations is None else tuple(stations)
    check_stations(wanted, HORIZONTAL, "stations")
    lat_deg, lon_deg = read_positions(positions_csv, wanted)
    source, content = _find(folder, day)
    fields = text_fields(content.decode("latin-1"), source)
    if fields.shape[1] != len(_FIELDS):
        hint = ", as a file of AP2 has" if fields.shape[1] == 7 else ""
        raise InputError(
            f"{source}: line 1: expected {len(_FIELDS)} fields, got {fields.shape[1]}{hint}"
        )
    table = CsvTable(source, _FIELDS, fields)
    times = _times(table, day)
    expected, lowest = f"a number, {MISSING:g} where it is missing", -np.inf
    if most_missing is None:
        expected, lowest = "no missing value, as irradiance.gaps is 'refuse'", MISSING + 1.0
    ghi_wm2 = table.numbers(wanted, expected, lowest)
    ghi_wm2[ghi_wm2 == MISSING] = np.nan
    check_ghi(table, wanted, ghi_wm2)
    found = Irradiance(times, np.maximum(ghi_wm2, 0.0), wanted, lat_deg, lon_deg, source)
    if most_missing is None:
        return found
    complete = fill_from_neighbours(_without_silent(found, most_missing))
    name = source.rpartition("/")[2]
    return replace(complete, report=tuple(f"{name}: {line}" for line in complete.report))


def latest_day_before(folder: Path, day: date) -> date:
    names = [path.name for path in folder.glob("*.txt")]
    for month in folder.glob("*.zip"):
        if re.fullmatch(r"\d{6}", month.stem) and month.stem <= f"{day:%Y%m}":
            with _archive(month) as archive:
                names += archive.namelist()
    stems = pd.Series([Path(name).stem for name in names if name.endswith(".txt")], dtype=str)
    days = pd.to_datetime(stems, format="%Y%m%d", errors="coerce")
    earlier = days[days < pd.Timestamp(day)]
    if earlier.empty:
        raise InputError(
            f"{folder}: expected {_ACCEPTED} of a day before {day:%Y-%m-%d}, from which "
            "neighbours.history = 'earlier-day' takes the past, got none"
        )
    return earlier.max().date()


def _find(folder: Path, day: date) -> tuple[str, bytes]:
    plain = folder / f"{day:%Y%m%d}.txt"
    month = folder / f"{day:%Y%m}.zip"
    if plain.is_file():
        return str(plain), plain.read_bytes()
    if month.is_file():
        with _archive(month) as archive:
            for name in archive.namelist():
                if Path(name).name == plain.name:
                    return f"{month}/{name}", archive.read(name)
    raise InputError(f"{folder}: expected {_ACCEPTED} of {day:%Y-%m-%d}, got none")


@contextmanager
def _archive(month: Path) -> Iterator[ZipFile]:
    try:
        with ZipFile(month) as archive:
            yield archive
    except (BadZipFile, RuntimeError, NotImplementedError) as error:
        raise InputError(f"{month}: expected a ZIP archive of daily files, got: {error}") from None


def _times(table: CsvTable, day: date) -> pd.DatetimeIndex:
    """Time stamps of all lines in UTC."""
    table.check_length()
    stamp, of_day = table.numbers(_TIME_FIELDS), day.timetuple().tm_yday
    second, year, day_of_year, clock = stamp.T
    hour, minute = np.divmod(clock, 100.0)
    bad = (year != day.year) | (day_of_year != of_day) | (hour > 23) | (minute > 59) | (second > 59)
    bad |= ((stamp % 1.0 != 0.0) | (stamp < 0.0)).any(axis=1)
    if bad.any():
        row = int(bad.argmax())
        raise InputError(
            f"{table.name}: line {row + 1}: expected {', '.join(_TIME_FIELDS)} of day {of_day} of "
            f"{day.year}, got {', '.join(f'{value:g}' for value in stamp[row])}"
        )
    second_of_day = hour * 3600.0 + minute * 60.0 + second
    midnight = pd.Timestamp(day).tz_localize(TIMEZONE).tz_convert("UTC")
    times = pd.DatetimeIndex(midnight + pd.to_timedelta(second_of_day, unit="s")).as_unit("ns")
    table.check_steady("second", times.asi8)
    return times


def _without_silent(found: Irradiance, most_missing: float) -> Irradiance:
    """Leave out the sensors of which too much is missing."""
    missing = np.isnan(found.ghi_wm2).sum(axis=0)
    total = len(found.times)
    kept = np.flatnonzero(missing <= most_missing * total)
    limit = f"more than {100.0 * most_missing:g} % of the day"
    if not kept.size:
        raise InputError(
            f"{found.source}: expected at least one sensor with data, got {limit} missing of each"
        )
    report = [
        f"{name}: {missing[sensor]:,} of {total:,} values missing, {limit}: left out, with its"
        " inverter"
        for sensor, name in enumerate(found.sensors)
        if sensor not in kept
    ]
    return replace(
        found,
        ghi_wm2=found.ghi_wm2[:, kept],
        sensors=tuple(found.sensors[sensor] for sensor in kept),
        lat_deg=found.lat_deg[kept],
        lon_deg=found.lon_deg[kept],
        report=tuple(report),
    )
