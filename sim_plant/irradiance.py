"""Measured irradiance: one time series of GHI for each sensor, and where the sensors stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError, listed
from sim_plant import Floats
from sim_plant.csv_tables import CsvTable, read_csv

GHI_MIN_WM2 = -10.0
GHI_MAX_WM2 = 2000.0

# Even a dull day exceeds this many W/m^2, and no sensor on Earth reaches as many kW/m^2.
_KILOWATT_BELOW = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Irradiance:
    """GHI of some sensors.

    ghi_wm2: A column for each sensor, a row for each UTC time, with one constant step; none is
        negative.
    coordinates: `lat` and `lon` of each sensor [degree], north and east positive.
    source: The file.
    report: Lines on what was filled or left out.
    longest_gap_s: Longest gap that was filled on straight lines in time.
    """

    ghi_wm2: pd.DataFrame
    coordinates: pd.DataFrame
    source: str
    report: tuple[str, ...] = ()
    longest_gap_s: float = 0.0

    @property
    def times(self) -> pd.DatetimeIndex:
        return pd.DatetimeIndex(self.ghi_wm2.index)

    @property
    def sensors(self) -> tuple[str, ...]:
        return tuple(self.ghi_wm2.columns)


def read_measured_ghi(
    ghi_csv: Path,
    positions_csv: Path,
    stations: Sequence[str] | None = None,
    max_gap_s: float | None = None,
) -> Irradiance:
    """Read measured GHI and the coordinates of the sensors from two CSV files.

    The first column of `ghi_csv`, whatever its header, is the time stamp, with its offset from UTC
    and in constant steps. Every other column is one sensor, named by the header, in W/m^2. Gaps of
    at most `max_gap_s` are filled; by default there may be none. Pyranometers read a little below
    zero at night: values from -10 to 0 W/m^2 are set to 0.

    `stations` are the sensors wanted, in this order. By default they are all columns of `ghi_csv`,
    which must then be all stations of `positions_csv`: a file that lacks some is that of a smaller
    plant. Values of other columns are not checked.
    """
    table = read_csv(ghi_csv)
    stamp, *known = table.header
    if stations is None:
        positions = read_csv(positions_csv)
        positions.check_header(("station",))
        if missing := [name for name in positions.names("station") if name not in known]:
            raise InputError(
                f"{ghi_csv.name}: line 1: expected a column for each station of "
                f"{positions_csv.name}, or irradiance.stations, got none for {listed(missing)}"
            )
    wanted = tuple(known if stations is None else stations)
    check_stations(wanted, known, f"{table.name}: line 1: stations")
    coordinates = read_coordinates(positions_csv, wanted)
    may_lack, expected = max_gap_s is not None, "a number in W/m2"
    if not may_lack:
        expected += " (irradiance.max_gap_s fills gaps)"
    numbers = table.numbers(wanted, expected, empty_is_missing=may_lack)
    times = table.times(stamp)
    table.check_steady(stamp, times.asi8, may_lack=may_lack)
    found = checked_ghi(table, wanted, numbers).set_axis(times)
    if max_gap_s is None:
        return Irradiance(found, coordinates, str(ghi_csv))
    complete, longest_s, report = _without_gaps(table, found, max_gap_s)
    return Irradiance(complete, coordinates, str(ghi_csv), report, longest_s)


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
    every = found.reindex(pd.date_range(times[0], times[-1], freq=pd.Timedelta(seconds=step_s)))
    steps = every.apply(_steps_of_gaps)  # Of the gap that each missing value is in.
    longest, missing = steps.max(), (steps > 0).sum()
    limit = min(max_gap_s / step_s, len(every) - 1)
    too_long = []
    for name in longest.index[longest > limit]:
        row = times.searchsorted(every.index[(steps[name] > limit).argmax()])
        line = table.fields.index[max(int(row) - 1, 0)] + 1
        too_long.append(f"{longest[name] * step_s:g} s of {name} (see line {line})")
    if too_long:
        expected = f"gaps of at most {max_gap_s:g} s, as max_gap_s says"
        raise InputError(f"{table.name}: expected {expected}, got {listed(too_long)}")
    if not missing.any():
        return every, 0.0, ()
    of_each = listed([f"{name} {count:,}" for name, count in missing.items() if count])
    quality = (
        f"{table.name}: {missing.sum():,} of {every.size:,} values were missing, in gaps of at "
        f"most {longest.max() * step_s:g} s, and are interpolated: {of_each}"
    )
    return every.interpolate(limit_direction="both"), longest.max() * step_s, (quality,)


def _steps_of_gaps(values: pd.Series) -> pd.Series:
    """Return, at each missing value, how many are missing in a row; 0 where there is a value."""
    missing = values.isna()
    return missing.groupby(missing.ne(missing.shift()).cumsum()).transform("sum")


def read_coordinates(path: Path, stations: Sequence[str]) -> pd.DataFrame:
    """Return `lat` and `lon` of stations [degree], from a CSV `station, lat, lon`."""
    coordinates = read_csv(path).coordinates("station")
    if missing := [name for name in stations if name not in coordinates.index]:
        raise InputError(f"{path.name}: expected a line for each station, got none for {missing}")
    return coordinates.loc[list(stations)]


def checked_ghi(table: CsvTable, columns: Sequence[str], ghi_wm2: Floats) -> pd.DataFrame:
    """Return GHI of sensors without negatives, after a check that it is in W/m^2; NaN is a gap."""
    bad = np.argwhere((ghi_wm2 < GHI_MIN_WM2) | (ghi_wm2 > GHI_MAX_WM2))
    if bad.size:
        row, column = bad[0]
        expected = f"{GHI_MIN_WM2:g} to {GHI_MAX_WM2:g} W/m2"
        raise table.error(int(row), columns[column], expected)
    largest = float(np.nanmax(ghi_wm2, initial=GHI_MIN_WM2))
    if 0.0 < largest < _KILOWATT_BELOW:
        raise InputError(
            f"{table.name}: expected W/m2, with a maximum of at least {_KILOWATT_BELOW:g}, got at "
            f"most {largest:g}, which seems to be in kW/m2"
        )
    return pd.DataFrame(np.maximum(ghi_wm2, 0.0), columns=list(columns))


def check_stations(stations: Sequence[str], known: Sequence[str], where: str) -> None:
    """Refuse stations that are not known or come twice, and none at all."""
    if not stations or len(set(stations)) < len(stations) or not set(stations) <= set(known):
        got = ", ".join(stations) or "none"
        raise InputError.of(where, f"expected {listed(known)}, each at most once, got {got}")
