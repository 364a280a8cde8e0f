"""Daily files of the NREL Oahu Solar Measurement Grid, as they come from the archive.

One file for each day, `YYYYMMDD.txt`: no header, a line each second from 05:00:00 to 20:00:00
Hawaii Standard Time (UTC-10 all the year), 23 fields separated by commas: second, year, day of the
year, hour and minute (500 is 05:00), then the W/m^2 of 19 sensors, -99999 where a value is missing
[1]_. Two of the 19 are tilted and are left out: DH1T and AP6T. That leaves the 17 horizontal
sensors of the paper. An eighteenth, AP2, was logged every 3 seconds, to files of their own.

.. [1] M. Sengupta and A. Andreas, "Oahu Solar Measurement Grid (1-Year Archive)", NREL report
   DA-5500-56506, 2010, doi:10.5439/1052451
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import date, timedelta, timezone
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.gap_filling import fill_from_neighbours
from sim_plant.irradiance import Irradiance, check_stations, checked_ghi, places_of, read_positions

MISSING: Final = -99999.0

_SENSORS: Final = (
    *("DH3", "DH4", "DH5", "DH10", "DH11", "DH9", "DH2", "DH1", "DH1T", "AP6", "AP6T"),
    *("AP1", "AP3", "AP5", "AP4", "AP7", "DH6", "DH7", "DH8"),
)
_TIME_FIELDS: Final = ("second", "year", "day of year", "hour and minute")
_FIELDS: Final = (*_TIME_FIELDS, *_SENSORS)
HORIZONTAL: Final = tuple(name for name in _SENSORS if name not in {"DH1T", "AP6T"})
"""The 17 horizontal sensors, in the order of their fields."""

TIMEZONE: Final = timezone(-timedelta(hours=10), "HST")


def read_day(
    folder: Path,
    day: date,
    positions_csv: Path,
    stations: Sequence[str] | None = None,
    most_missing: float = 0.0,
) -> Irradiance:
    """Read one day, in Hawaii, and see to its missing values.

    Values from -10 to 0 W/m^2, which the sensors show at night, are set to 0. By default all 17
    horizontal sensors are read. One of which a larger share of the day than `most_missing` is
    missing is left out; what is missing of the others is filled from their neighbours among the
    sensors that are used.
    """
    wanted = HORIZONTAL if stations is None else tuple(stations)
    check_stations(wanted, HORIZONTAL, "stations")
    coordinates = places_of(wanted, read_positions(positions_csv), positions_csv.name)
    path = folder / f"{day:%Y%m%d}.txt"
    table = read_csv(path, header=_FIELDS)
    times = _times(table, day)
    ghi_wm2 = table.numbers(wanted, f"a number, {MISSING:g} where it is missing")
    ghi_wm2[ghi_wm2 == MISSING] = np.nan
    checked = checked_ghi(table, wanted, ghi_wm2, None, times, coordinates).set_index(times)
    found = Irradiance(checked, coordinates, str(path), tuple(table.notes))
    complete = fill_from_neighbours(_without_sparse(found, most_missing))
    return replace(complete, report=tuple(f"{path.name}: {line}" for line in complete.report))


def latest_day_before(folder: Path, day: date) -> date:
    names = pd.Series([path.stem for path in folder.glob("*.txt")], dtype=str)
    days = pd.to_datetime(names, format="%Y%m%d", errors="coerce")
    earlier = days[days < pd.Timestamp(day)]
    if earlier.empty:
        raise InputError(
            f"{folder}: expected YYYYMMDD.txt of a day before {day:%Y-%m-%d}, from which "
            "neighbours.history = 'earlier-day' takes the past, got none"
        )
    return earlier.max().date()


def _times(table: CsvTable, day: date) -> pd.DatetimeIndex:
    second, year, day_of_year, clock = table.numbers(_TIME_FIELDS).T
    other = (year != day.year) | (day_of_year != day.timetuple().tm_yday)
    if other.any():
        raise table.error(int(other.argmax()), "day of year", f"that of {day:%Y-%m-%d}")
    hour, minute = np.divmod(clock, 100.0)
    second_of_day = hour * 3600.0 + minute * 60.0 + second
    midnight = pd.Timestamp(day).tz_localize(TIMEZONE).tz_convert("UTC")
    times = pd.DatetimeIndex(midnight + pd.to_timedelta(second_of_day, unit="s")).as_unit("ns")
    table.steady("second", times.asi8)
    return times


def _without_sparse(found: Irradiance, most_missing: float) -> Irradiance:
    """Leave out the sensors of which too much is missing."""
    missing = found.ghi_wm2.isna().sum()
    total = len(found.ghi_wm2)
    kept = missing <= most_missing * total
    limit = f"more than {100.0 * most_missing:g} % of the day"
    if not kept.any():
        raise InputError(
            f"{found.source}: expected at least one sensor with data, got {limit} missing of each"
        )
    report = tuple(
        f"{name}: {count:,} of {total:,} values missing, {limit}: left out, with its inverter"
        for name, count in missing[~kept].items()
    )
    report = found.report + report
    return Irradiance(found.ghi_wm2.loc[:, kept], found.coordinates[kept], found.source, report)
