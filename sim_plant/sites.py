"""Where a plant's inverters stand and how large they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from bus_schemas.tree import check_name
from sim_plant.csv_tables import CsvTable, read_csv


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """The inverters of a plant, n of them.

    Attributes
    ----------
    names
        Names of the inverters.
    lat_deg, lon_deg
        Positions, shape (n,).
    rating_kw
        AC ratings, shape (n,).
    """

    names: tuple[str, ...]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    rating_kw: NDArray[np.float64]


def read_sites(path: Path, plant_rating_kw: float | None) -> Sites:
    """Read inverters from a CSV with the columns `inverter, lat, lon` and maybe `rating_kw`.

    Parameters
    ----------
    path
        The CSV file. Further columns are left alone.
    plant_rating_kw
        Rating of the whole plant, to be split equally, where the file has no `rating_kw`.

    Raises
    ------
    InputError
        With file, line and column of what cannot be used.
    """
    table = read_csv(path)
    table.check_header(("inverter", "lat", "lon"))
    if table.fields.empty:
        raise InputError(f"{path.name}: expected a line for each inverter, got none")
    if "rating_kw" in table.header:
        smallest_kw = float(np.nextafter(0.0, 1.0))
        rating_kw = _column(table, "rating_kw", "a number above 0, up to 1e7", smallest_kw, 1e7)
    else:
        rating_kw = equal_ratings_kw(plant_rating_kw, len(table.fields), path.name)
    return Sites(
        _names(table),
        _column(table, "lat", "a number from -90 to 90", -90.0, 90.0),
        _column(table, "lon", "a number from -180 to 180", -180.0, 180.0),
        rating_kw,
    )


def inverter_name(station: str) -> str:
    """Name the inverter at a station: `16` becomes `inv16`, `inv04` stays as it is."""
    return station if station.startswith("inv") else f"inv{station}"


def equal_ratings_kw(
    plant_rating_kw: float | None, inverters: int, where: str
) -> NDArray[np.float64]:
    """Split a plant's rating equally [kW], shape (inverters,).

    Raises
    ------
    InputError
        There is no rating to split.
    """
    if plant_rating_kw is None:
        raise InputError(f"{where}: expected plant.rating_kw or a column rating_kw, got neither")
    return np.full(inverters, plant_rating_kw / inverters)


def _names(table: CsvTable) -> tuple[str, ...]:
    names = table.names("inverter")
    for row, name in enumerate(names):
        check_name(name, f"{table.name}: line {row + 2}")
        if name in names[:row]:
            raise table.error(row, "inverter", "a name that no other inverter has")
    return names


def _column(
    table: CsvTable, column: str, expected: str, low: float, high: float
) -> NDArray[np.float64]:
    return table.numbers((column,), expected, low, high)[:, 0]
