"""Measured irradiance: one time series of GHI for each sensor, and where the sensors stand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from bus_schemas.errors import InputError, listed
from sim_plant import Floats, imported_when_used
from sim_plant.clear_sky import clear_ghi, stamps_by_sun
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.table_layout import irradiance_factor, name_and_unit

pvlib = imported_when_used("pvlib")

GHI_MIN_WM2: Final = -20.0
GHI_NIGHT_MIN_WM2: Final = -60.0
"""By night a thermopile reads below zero, since it radiates to the cold sky."""

GHI_MAX_WM2: Final = 2000.0

# Even a dull day exceeds this many W/m^2, and no sensor on Earth reaches as many kW/m^2.
_KILOWATT_BELOW: Final = 2.0

Stamps: TypeAlias = Literal["begin", "middle", "end"]
_NAMED: Final[dict[str, Stamps]] = {
    **{"end": "end", "ending": "end"},
    **{"begin": "begin", "beginning": "begin", "start": "begin"},
}


class StatedForm(msgspec.Struct, frozen=True, kw_only=True):
    """What a file of irradiance may leave open, and its user states.

    timezone: Zone of time stamps without an offset. Default: `time.timezone`.
    dates: Order of dates, where the time stamps leave it open.
    unit: Unit, where the header does not say it. Default: W/m2.
    stamps: Moment of its interval that a time stamp names. Default: by the header, else by the
        sun's path for steps of a minute or more, else `begin`.
    """

    timezone: str | None = None
    dates: Literal["day-first", "month-first"] | None = None
    unit: Literal["W/m2", "kW/m2"] | None = None
    stamps: Stamps | None = None


_AS_IT_SAYS: Final = StatedForm()


@dataclass(frozen=True, slots=True, eq=False)
class Irradiance:
    """GHI of some sensors.

    ghi_wm2: A column for each sensor, a row for each UTC time, with one constant step; none is
        negative.
    coordinates: `lat` and `lon` of each sensor [degree], north and east positive.
    source: The file.
    report: Lines on what was filled or left out.
    longest_gap_s: Longest gap that was filled on straight lines in time.
    stamps: Which moment of its interval a time stamp was taken to name, where it matters.
    """

    ghi_wm2: pd.DataFrame
    coordinates: pd.DataFrame
    source: str
    report: tuple[str, ...] = ()
    longest_gap_s: float = 0.0
    stamps: Stamps | None = None

    @property
    def times(self) -> pd.DatetimeIndex:
        return pd.DatetimeIndex(self.ghi_wm2.index)

    @property
    def sensors(self) -> tuple[str, ...]:
        return tuple(self.ghi_wm2.columns)

    def around(self, wanted: pd.DatetimeIndex) -> Irradiance:
        """Return what covers some times, the hours that they are in, and a step on both sides.

        It is all, if some of that is missing.
        """
        hour = pd.Timedelta(hours=1)
        first, last = wanted[0] - hour, wanted[-1] + hour
        if first < self.times[0] or last > self.times[-1]:
            return self
        low, high = self.times.searchsorted([first, last], side="right")
        return replace(self, ghi_wm2=self.ghi_wm2.iloc[low - 1 : high + 1])


def read_measured_ghi(
    ghi_csv: Path,
    positions_csv: Path,
    stations: Sequence[str] | None = None,
    max_gap_s: float | None = None,
    form: StatedForm = _AS_IT_SAYS,
) -> Irradiance:
    """Read measured GHI and the coordinates of the sensors from two files.

    The time stamps keep one step, within a tenth of it. Every other column is one sensor, named by
    the header, in W/m^2; in a long table one column has the names and one the values. Gaps of at
    most `max_gap_s` are filled; by default there may be none. Values a little below zero, as
    pyranometers show them at night, are set to 0.

    `stations` are the sensors wanted, in this order. By default they are all columns of `ghi_csv`,
    which must then be all stations of `positions_csv`: a file that lacks some is that of a smaller
    plant. Values of other columns are not checked.
    """
    positions = read_positions(positions_csv)
    table = wide(read_csv(ghi_csv), tuple(positions.index))
    return measured_ghi(table, positions, positions_csv.name, stations, max_gap_s, form)


def measured_ghi(
    table: CsvTable,
    positions: pd.DataFrame,
    positions_name: str,
    stations: Sequence[str] | None,
    max_gap_s: float | None,
    form: StatedForm,
) -> Irradiance:
    """Return the irradiance in a table with a column for each station; the rest is as above."""
    known = [station_of(name, positions.index) for name in table.value_columns]
    if stations is None:
        if missing := [name for name in positions.index if name not in known]:
            raise InputError(
                f"{table.name}: line 1: expected a column for each station of "
                f"{positions_name}, or irradiance.stations, got none for {listed(missing)}"
            )
        stations = [name for name in known if name in positions.index]
    check_stations(stations, known, f"{table.name}: line 1: stations")
    columns = dict(zip(known, table.value_columns, strict=True))
    wanted = [columns[name] for name in stations]
    coordinates = places_of(stations, positions, positions_name)
    may_lack, expected = max_gap_s is not None, "a number in W/m2"
    if not may_lack:
        expected += " (irradiance.max_gap_s fills gaps)"
    times = table.times(form.timezone, form.dates)
    ordered, time_ns = table.steady(table.stamp, times.asi8, may_lack=may_lack)
    times = pd.DatetimeIndex(time_ns, tz="UTC")
    values = ordered.numbers(wanted, expected, empty_is_missing=True, sentinels=True)
    if not may_lack and np.isnan(values).any():
        row, column = np.argwhere(np.isnan(values))[0]
        raise ordered.error(int(row), wanted[column], expected)
    factors = _factors(table, wanted, form.unit)
    values = values if (factors == 1.0).all() else values * factors
    ghi_wm2 = checked_ghi(ordered, wanted, values, form.unit, times, coordinates)
    found = pd.DataFrame(ghi_wm2.to_numpy(), times, list(stations))
    found.index, stamps = _begins(table, found, coordinates, form.stamps)
    longest_s, report = 0.0, tuple[str, ...]()
    if max_gap_s is not None:
        found, longest_s, report = _without_gaps(ordered, found, max_gap_s)
    report = table.said() + report
    return Irradiance(found, coordinates, str(table.path), report, longest_s, stamps)


def station_of(column: str, stations: pd.Index) -> str:
    """Return the station that a column is of: its name as it is, or without a unit."""
    names = {name_and_unit(str(name))[0]: str(name) for name in stations}
    return column if column in stations else names.get(name_and_unit(column)[0], column)


def wide(table: CsvTable, stations: Sequence[str]) -> CsvTable:
    """Return a table with a column for each station, from one with a line for each value."""
    columns = table.value_columns
    if any(station_of(name, pd.Index(stations)) in stations for name in columns):
        return table
    named = [one for one in columns if set(table.text(one).head(2000)) & set(stations)]
    values = [one for one in columns if one not in named and is_numeric_dtype(table.column(one))]
    if len(named) != 1 or len(values) != 1:
        return table
    of, value = named[0], values[0]
    frame = pd.DataFrame({"time": table.stamps, "of": table.text(of), "value": table.column(value)})
    again = frame.duplicated(["time", "of"])
    if again.any():
        raise table.error(int(again.argmax()), of, "one value of each station at a time")
    lines = frame.drop_duplicates("time")  # The first line of each time stands for it.
    spread = frame.pivot(index="time", columns="of", values="value").loc[lines["time"]]
    table.notes.append(f"a line for each value: {of} names the station")
    return replace(
        table,
        fields=spread.set_axis(lines.index),
        stamps=table.stamps[lines.index],
        units=dict.fromkeys(spread.columns, table.units[value]),
    )


def _factors(table: CsvTable, columns: Sequence[str], stated: str | None) -> Floats:
    """Return by what the values of each column are multiplied, by their units."""
    factors = []
    for column in columns:
        unit = stated or table.units[column]
        factor = irradiance_factor(unit) if unit else 1.0
        if factor is None:
            raise InputError(
                f"{table.name}: line 1: column '{column}': expected W/m2 or kW/m2, got {unit}"
            )
        factors.append(factor)
        if factor != 1.0:
            table.notes.append(f"{unit} was converted to W/m2")
    return np.array(factors)


def _begins(
    table: CsvTable, ghi_wm2: pd.DataFrame, coordinates: pd.DataFrame, stamps: Stamps | None
) -> tuple[pd.DatetimeIndex, Stamps | None]:
    """Return the begin of the interval that each time stamp names, and which moment that is."""
    times = pd.DatetimeIndex(ghi_wm2.index)
    step = pd.Timedelta(int(np.median(np.diff(times.asi8))), unit="ns")
    if stamps is None:
        words = re.findall("[a-z]+", table.stamp.lower())
        if stamps := next((_NAMED[word] for word in words if word in _NAMED), None):
            table.notes.append(f"a time stamp names the {stamps} of its interval, by its header")
        elif step < pd.Timedelta(minutes=1):
            return times, None  # The sun moves too little to tell, or to matter.
        else:
            stamps, why = stamps_by_sun(ghi_wm2.mean(axis=1), coordinates, step)
            table.notes.append(f"a time stamp names the {stamps} of its interval, {why}")
    return times - {"begin": 0 * step, "middle": step / 2, "end": step}[stamps], stamps


def _without_gaps(
    table: CsvTable, found: pd.DataFrame, max_gap_s: float
) -> tuple[pd.DataFrame, float, tuple[str, ...]]:
    """Return values in one step, the longest gap in them [s], and a line if any was filled.

    A gap, missing values or missing lines, is as long as the steps that it lacks. It is filled on
    the straight line from the value before it to the one after it; at the ends the nearest value
    holds.
    """
    times = pd.DatetimeIndex(found.index)
    step_s = float(np.diff(times.asi8).min()) / 1e9
    grid = pd.date_range(times[0], times[-1], freq=pd.Timedelta(seconds=step_s))
    every = found.set_axis(grid) if len(grid) == len(times) else found.reindex(grid)
    missing = every.isna().sum()
    missing = missing[missing > 0]
    if missing.empty:
        return every, 0.0, ()
    steps = every[missing.index].apply(_steps_of_gaps)  # Of the gap that a missing value is in.
    longest = steps.max()
    if empty := [str(name) for name in longest.index[longest == len(every)]]:
        raise InputError(f"{table.name}: expected values, got none of {listed(empty)}")
    limit = max_gap_s / step_s
    too_long = []
    for name in longest.index[longest > limit]:
        row = times.searchsorted(every.index[(steps[name] > limit).argmax()])
        line = table.fields.index[max(int(row) - 1, 0)] + 1
        too_long.append(f"{longest[name] * step_s:g} s of {name} (see line {line})")
    if too_long:
        expected = f"gaps of at most {max_gap_s:g} s, as max_gap_s says"
        raise InputError(f"{table.name}: expected {expected}, got {listed(too_long)}")
    of_each = listed([f"{name} {count:,}" for name, count in missing.items()])
    quality = (
        f"{table.name}: {missing.sum():,} of {every.size:,} values were missing, in gaps of at "
        f"most {longest.max() * step_s:g} s, and are interpolated: {of_each}"
    )
    return every.interpolate(limit_direction="both"), longest.max() * step_s, (quality,)


def _steps_of_gaps(values: pd.Series) -> pd.Series:
    """Return, at each missing value, how many are missing in a row; 0 where there is a value."""
    missing = values.isna()
    return missing.groupby(missing.ne(missing.shift()).cumsum()).transform("sum")


def read_positions(path: Path) -> pd.DataFrame:
    """Return `lat` and `lon` of stations [degree], from a file with `station, lat, lon`."""
    return read_csv(path, ("station", "lat", "lon"), texts=("station",)).coordinates("station")


def places_of(stations: Sequence[str], positions: pd.DataFrame, name: str) -> pd.DataFrame:
    if missing := [station for station in stations if station not in positions.index]:
        raise InputError(f"{name}: expected a line for each station, got none for {missing}")
    return positions.loc[list(stations)]


def checked_ghi(
    table: CsvTable,
    columns: Sequence[str],
    ghi_wm2: Floats,
    unit: str | None,
    times: pd.DatetimeIndex,
    coordinates: pd.DataFrame,
) -> pd.DataFrame:
    """Refuse values that no sensor shows, NaN aside; set those below 0 to 0."""
    smallest = float(np.nanmin(ghi_wm2, initial=0.0))
    largest = float(np.nanmax(ghi_wm2, initial=GHI_NIGHT_MIN_WM2))
    if smallest < GHI_MIN_WM2 or largest > GHI_MAX_WM2:
        odd = np.flatnonzero(((ghi_wm2 < GHI_MIN_WM2) | (ghi_wm2 > GHI_MAX_WM2)).any(axis=1))
        sun = pvlib.solarposition.get_solarposition(times[odd], *coordinates.mean())["elevation"]
        lowest = np.where(sun < 0.0, GHI_NIGHT_MIN_WM2, GHI_MIN_WM2)
        bad = np.argwhere((ghi_wm2[odd] < lowest[:, None]) | (ghi_wm2[odd] > GHI_MAX_WM2))
        if bad.size:
            row, column = bad[0]
            when = " by night" if lowest[row] == GHI_NIGHT_MIN_WM2 else ""
            expected = f"{lowest[row]:g} to {GHI_MAX_WM2:g} W/m2{when}"
            raise table.error(int(odd[row]), columns[column], expected)
    is_faint = 0.0 < largest < _KILOWATT_BELOW and unit is None and not table.units[columns[0]]
    if is_faint and clear_ghi(times[:: len(times) // 1000 + 1], coordinates).max() > 50.0:
        raise InputError(
            f"{table.name}: expected W/m2, with a maximum of at least {_KILOWATT_BELOW:g}, got at "
            f"most {largest:g}: irradiance.unit (--unit) says whether that is W/m2 or kW/m2"
        )
    if smallest < 0.0:
        table.notes.append(
            f"set to 0: {(ghi_wm2 < 0.0).sum():,} of the values, from {smallest:g} W/m2 up"
        )
        ghi_wm2 = np.maximum(ghi_wm2, 0.0)
    return pd.DataFrame(ghi_wm2, columns=list(columns), copy=False)


def check_stations(stations: Sequence[str], known: Sequence[str], where: str) -> None:
    """Refuse stations that are not known or come twice, and none at all."""
    if not stations or len(set(stations)) < len(stations) or not set(stations) <= set(known):
        got = ", ".join(stations) or "none"
        raise InputError.of(where, f"expected {listed(known)}, each at most once, got {got}")
