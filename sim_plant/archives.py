"""Irradiance of one station from the archives that pvlib reads, as a table of a whole plant.

The clouds over the station are taken as a frozen field that moves with the wind: a station of the
plant that lies downwind sees the same clear-sky index later. Without wind all see the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pvlib import iotools

from bus_schemas.errors import InputError, not_one_of
from sim_plant import Floats
from sim_plant.clear_sky import clear_ghi
from sim_plant.sites import east_north_m

_ANY_YEAR: Final = 2023
"""Of a typical year, whose months are of several years."""


def _solcast(path: str) -> pd.DataFrame:
    data: pd.DataFrame = pd.read_csv(path)
    data.columns = [re.sub("_", "", str(name)).lower() for name in data.columns]
    return data.set_index(pd.to_datetime(data["periodend"], utc=True))


def _pvgis(path: str) -> pd.DataFrame:
    """Read an hourly file of a flat plane, or a typical year."""
    try:
        found, meta = iotools.read_pvgis_hourly(path)
    except (KeyError, ValueError, UnboundLocalError, IndexError):
        found, _ = iotools.read_pvgis_tmy(path)
        return pd.DataFrame(found)
    data = pd.DataFrame(found)
    if "ghi" not in data:
        parts = [name for name in data.columns if name.startswith("poa_")]
        slope = str(meta).lower().partition("slope")[2][:60]
        if not parts or not re.match(r"[^0-9]*0(\.0)?\b", slope):
            raise ValueError("irradiance on a tilted plane; PVGIS gives the flat one with slope 0")
        data["ghi"] = data[parts].sum(axis=1)
    return data


_READERS: Final[dict[str, tuple[Callable[[str], Any], float]]] = {
    "srml": (iotools.read_srml, 0.0),
    "surfrad": (iotools.read_surfrad, 0.0),
    "midc": (iotools.read_midc, 0.0),
    "bsrn": (iotools.read_bsrn, 0.0),
    "psm3": (iotools.read_nsrdb_psm4, 0.5),
    "psm4": (iotools.read_nsrdb_psm4, 0.5),
    "epw": (lambda path: iotools.read_epw(path, coerce_year=_ANY_YEAR), 0.0),
    "tmy3": (lambda path: iotools.read_tmy3(path, coerce_year=_ANY_YEAR), 0.0),
    "solaranywhere": (iotools.read_solaranywhere, 1.0),
    "solcast": (_solcast, 1.0),
    "pvgis": (_pvgis, 0.5),
}
"""pvlib's reader of each archive, and where in its interval the index is, in steps."""

_SIGNS: Final = {
    "epw": r"LOCATION,",
    "psm4": r"Source,Location ID",
    "bsrn": r" ?\*[CU]0001",
    "srml": r"\d{5}\t\d{4}\t1\d{3}\t",
    "pvgis": r"Latitude \(decimal degrees\)",
    "solaranywhere": r"\d+,.*Data Version",
    "tmy3": r"\d{6},\"?[^,]+\"?,[A-Z]{2},",
    "surfrad": r" ?[A-Z][A-Za-z ]+\n\s+-?\d+\.\d+ +-?\d+\.\d+ +\d+ m",
    "midc": r"DATE \(MM/DD/YYYY\),[A-Z]{3}",
    "solcast": r"(\ufeff)?(.*,)?period_?end(,|\n)",
}
"""How a file of each archive begins."""

_GHI: Final = re.compile(r"(?i)ghi(_\d+)?$|global (horizontal|cmp|psp|.*\[w/m)|^global.*w/m")


def archive_of(given: str) -> tuple[str, Path] | None:
    """Return archive and file of `srml:FILE`, or of a file by its content; None: neither."""
    kind, _, name = given.partition(":")
    if name and kind.isalnum() and not Path(given).exists():
        if kind not in _READERS:
            raise InputError(f"{given}: {not_one_of(_READERS, kind, 'one of the archives ')}")
        return kind, Path(name)
    path = Path(given)
    if not path.is_file():
        return None
    with path.open("rb") as file:
        start = file.read(2000).decode("utf-8", errors="replace").replace("\r\n", "\n")
    found = next((name for name, sign in _SIGNS.items() if re.match(sign, start)), None)
    return None if found is None else (found, path)


def read_archive(kind: str, path: Path) -> pd.Series:
    """Return the GHI of an archive's file by the begin of its intervals, in UTC [W/m^2]."""
    read, at = _READERS[kind]
    if not path.is_file():
        raise InputError(f"{path}: expected a file of {kind}, got none")
    try:
        found = read(str(path))
    except Exception as error:  # Of many kinds, deep in pvlib, for a file of another form.
        got = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{path}: expected a file of {kind}, got: {got}") from None
    data: pd.DataFrame = found[0] if isinstance(found, tuple) else found
    columns = [name for name in map(str, data.columns) if _GHI.search(name)]
    if not columns or data.empty:
        names = ", ".join(map(str, data.columns[:12]))
        raise InputError(f"{path}: expected a column with GHI, got {names or 'nothing'}")
    ghi_wm2 = pd.to_numeric(data[columns[0]], errors="coerce")
    times = pd.DatetimeIndex(data.index)
    times = times.tz_convert("UTC") if times.tz is not None else times.tz_localize("UTC")
    if not times.is_monotonic_increasing and len(set(times.year)) > 1:  # A typical year.
        keeps = (times.month != 2) | (times.day != 29)
        in_one_year = [time.replace(year=_ANY_YEAR) for time in times[keeps]]
        ghi_wm2, times = ghi_wm2[keeps], pd.DatetimeIndex(in_one_year)
    is_fine = np.median(np.abs(np.diff(times.as_unit("ns").asi8))) < 59e9
    times = times.as_unit("ns").round("s" if is_fine else "min")
    ghi_wm2 = ghi_wm2.set_axis(times)[~times.duplicated()].sort_index()
    step = pd.Timedelta(int(np.median(np.diff(pd.DatetimeIndex(ghi_wm2.index).asi8))), unit="ns")
    return ghi_wm2.set_axis(pd.DatetimeIndex(ghi_wm2.index) - at * step)


def cloud_text(kind: str, name: str, speed_m_s: float, from_deg: float) -> str:
    """Say how the irradiance of one station became that of a plant."""
    if speed_m_s == 0.0:
        return f"all inverters have the irradiance of one station ({kind}, {name}): none can help"
    return (
        f"the clouds over one station ({kind}, {name}) move over the plant, unchanged, at "
        f"{speed_m_s:g} m/s from {from_deg:g} degrees"
    )


def plant_under(
    ghi_wm2: pd.Series, coordinates: pd.DataFrame, speed_m_s: float, from_deg: float
) -> pd.DataFrame:
    """Return the GHI at each of some stations under the frozen clouds of one.

    The wind has a speed, 0 for none, and blows from a direction, clockwise from north.
    """
    times = pd.DatetimeIndex(ghi_wm2.index)
    columns = list(coordinates.index)
    if speed_m_s == 0.0:
        return pd.DataFrame(dict.fromkeys(columns, ghi_wm2))
    step = pd.Timedelta(int(np.median(np.diff(times.asi8))), unit="ns")
    clear = clear_ghi(times + step / 2, coordinates)
    known = ghi_wm2.to_numpy() / np.maximum(clear, 1.0)
    index = pd.Series(np.where(clear > 20.0, known, np.nan)).ffill().bfill().fillna(0.0).clip(0, 2)
    seconds = (times - times[0]).total_seconds().to_numpy()
    east_m, north_m = east_north_m(
        coordinates["lat"].to_numpy(np.float64), coordinates["lon"].to_numpy(np.float64)
    )
    towards = np.deg2rad(from_deg + 180.0)
    downwind_m: Floats = east_m * np.sin(towards) + north_m * np.cos(towards)
    return pd.DataFrame(
        {
            name: clear * np.interp(seconds - late_m / speed_m_s, seconds, index.to_numpy())
            for name, late_m in zip(columns, downwind_m, strict=True)
        },
        times,
    ).where(ghi_wm2.notna())
