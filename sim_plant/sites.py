"""Where a plant's inverters stand and how large they are."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Annotated, Final
from unicodedata import normalize

import msgspec
import numpy as np
from msgspec import Meta

from bus_schemas.errors import InputError
from bus_schemas.tree import MOST_INVERTERS, check_name
from sim_plant import Floats
from sim_plant.csv_tables import read_csv

_LONGEST_NAME: Final = 40
_METRES_PER_DEGREE: Final = np.deg2rad(1.0) * 6_371_000.0
"""Of latitude anywhere, and of longitude on the equator."""


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """The inverters of a plant: names, positions and AC ratings of n of them."""

    names: tuple[str, ...]
    lat_deg: Floats
    lon_deg: Floats
    rating_kw: Floats


class Grid(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Inverters in rows, each from west to east, the southernmost row first.

    rows: Number of rows.
    columns: Inverters in each row.
    apart_m: Distance in the row and between rows [m].
    lat: Latitude of the first one.
    lon: Longitude of the first one.
    """

    rows: Annotated[int, Meta(ge=1, le=MOST_INVERTERS)]
    columns: Annotated[int, Meta(ge=1, le=MOST_INVERTERS)]
    apart_m: Annotated[float, Meta(gt=0.0, le=10_000.0)]
    lat: Annotated[float, Meta(ge=-80.0, le=80.0)]
    lon: Annotated[float, Meta(ge=-180.0, le=180.0)]

    def sites(self, plant_rating_kw: float | None) -> Sites:
        """Return them by the names `inv001`, `inv002` and so on."""
        count = self.rows * self.columns
        if count > MOST_INVERTERS:
            raise InputError.of("plant.grid", f"expected 1 to {MOST_INVERTERS:,}, got {count:,}")
        row, column = np.divmod(np.arange(count), self.columns)
        step_deg = self.apart_m / _METRES_PER_DEGREE
        return Sites(
            tuple(f"inv{number:0{len(str(count))}}" for number in range(1, count + 1)),
            self.lat + row * step_deg,
            self.lon + column * step_deg / np.cos(np.deg2rad(self.lat)),
            equal_ratings_kw(plant_rating_kw, count, "plant.grid"),
        )


def read_sites(path: Path, plant_rating_kw: float | None) -> Sites:
    """Read inverters from a CSV with the columns `inverter, lat, lon` and maybe `rating_kw`.

    Without that column the rating of the plant is split equally. Further columns are left alone.
    """
    table = read_csv(path, ("inverter", "lat", "lon"), texts=("inverter",))
    coordinates = table.coordinates("inverter")
    names = tuple(coordinates.index)
    if not 0 < len(names) <= MOST_INVERTERS:
        raise InputError(f"{path.name}: expected 1 to {MOST_INVERTERS:,} lines, got {len(names):,}")
    for name in names:
        check_name(name, path.name)
    if "rating_kw" in table.value_columns:
        smallest_kw = float(np.nextafter(0.0, 1.0))
        expected = "a number above 0, up to 1e7"
        rating_kw = table.numbers(("rating_kw",), expected, smallest_kw, 1e7)[:, 0]
        if plant_rating_kw is not None and not isclose(plant_rating_kw, rating_kw.sum()):
            raise InputError.of(
                "plant.rating_kw",
                f"expected none, or {rating_kw.sum():.10g}, the sum of the column "
                f"rating_kw of {path.name}, got {plant_rating_kw:.10g}",
            )
    else:
        rating_kw = equal_ratings_kw(plant_rating_kw, len(names), path.name)
    return Sites(names, coordinates["lat"].to_numpy(), coordinates["lon"].to_numpy(), rating_kw)


def inverter_names(stations: Iterable[str]) -> tuple[str, ...]:
    """Name the inverters at stations: `16` becomes `inv16`, `inv04` stays as it is.

    What cannot stand in the name of a node becomes `-`: `Dach/Süd [1]` is `invDach-Sud-1`.
    """
    names: dict[str, None] = {}
    for number, station in enumerate(stations, 1):
        ascii_only = normalize("NFKD", station).encode("ascii", "ignore").decode()
        plain = re.sub(r"[^A-Za-z0-9_-]+", "-", ascii_only).strip("-")[:_LONGEST_NAME]
        name = plain if plain.startswith("inv") else f"inv{plain or f'-{number}'}"
        while name in names:
            name = f"{name}-{number}"
        names[name] = None
    return tuple(names)


def equal_ratings_kw(plant_rating_kw: float | None, inverters: int, where: str) -> Floats:
    if plant_rating_kw is None:
        raise InputError.of(where, "expected plant.rating_kw or a column rating_kw, got neither")
    return np.full(inverters, plant_rating_kw / inverters)


def east_north_m(lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats]:
    """Return metres east and north of the middle of all places, on a flat Earth."""
    shrink = np.cos(np.deg2rad(lat_deg.mean()))
    east_m = (lon_deg - lon_deg.mean()) * _METRES_PER_DEGREE * shrink
    return east_m, (lat_deg - lat_deg.mean()) * _METRES_PER_DEGREE


def placed_around(
    middle_deg: tuple[float, float], east_m: Floats, north_m: Floats
) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes of places of which the middle is known."""
    lat_deg, lon_deg = middle_deg
    shrink = np.cos(np.deg2rad(lat_deg))
    return (
        lat_deg + (north_m - north_m.mean()) / _METRES_PER_DEGREE,
        lon_deg + (east_m - east_m.mean()) / (_METRES_PER_DEGREE * shrink),
    )
