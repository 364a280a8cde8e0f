"""Measured irradiance: one time series of GHI for each sensor, and where the sensors stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError, listed
from sim_plant import Floats
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.time_gaps import without_gaps

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
        expected += " (irradiance.fill = 'interpolate' fills gaps)"
    numbers = table.numbers(wanted, expected, empty_is_missing=may_lack)
    ghi_wm2, times = checked_ghi(table, wanted, numbers), table.times(stamp)
    filled = without_gaps(table, stamp, times.asi8, ghi_wm2, max_gap_s)
    complete = filled.values.set_axis(pd.DatetimeIndex(filled.values.index, tz="UTC"))
    return Irradiance(complete, coordinates, str(ghi_csv), filled.report, filled.longest_gap_s)


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
        raise InputError(f"{where}: expected {listed(known)}, each at most once, got {got}")
