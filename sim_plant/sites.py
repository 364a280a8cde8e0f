"""Where a plant's inverters stand and how large they are."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from bus_schemas.tree import check_name


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
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            columns = set(reader.fieldnames or ())
            rows = [(reader.line_num, row) for row in reader]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, accepted is a CSV of inverters") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}, accepted is a CSV of inverters") from None
    except csv.Error as error:
        raise InputError(f"{path}: {error}, accepted is a CSV of inverters") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 at byte {error.start}, accepted is a CSV") from None
    for column in ("inverter", "lat", "lon"):
        if column not in columns:
            raise InputError(
                f"{path}, line 1: no column {column!r}, accepted are inverter, lat, lon and "
                "rating_kw"
            )
    if not rows:
        raise InputError(f"{path}: no inverters, accepted is one line for each")
    names = _names(path, rows)
    return Sites(
        names,
        np.array([_number(path, line, row, "lat", -90.0, 90.0) for line, row in rows]),
        np.array([_number(path, line, row, "lon", -180.0, 180.0) for line, row in rows]),
        _ratings(path, rows, "rating_kw" in columns, plant_rating_kw),
    )


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
        raise InputError(f"{where}: no ratings, accepted is plant.rating_kw or a column rating_kw")
    return np.full(inverters, plant_rating_kw / inverters)


def _names(path: Path, rows: list[tuple[int, dict[str, str]]]) -> tuple[str, ...]:
    first_line: dict[str, int] = {}
    for line, row in rows:
        name = (row["inverter"] or "").strip()
        check_name(name, f"{path}, line {line}")
        if name in first_line:
            raise InputError(
                f"{path}, line {line}: inverter {name} is in line {first_line[name]} already, "
                "names must differ"
            )
        first_line[name] = line
    return tuple(first_line)


def _ratings(
    path: Path,
    rows: list[tuple[int, dict[str, str]]],
    has_ratings: bool,
    plant_rating_kw: float | None,
) -> NDArray[np.float64]:
    if not has_ratings:
        return equal_ratings_kw(plant_rating_kw, len(rows), str(path))
    smallest_kw = np.nextafter(0.0, 1.0)
    return np.array([_number(path, line, row, "rating_kw", smallest_kw, 1e7) for line, row in rows])


def _number(
    path: Path, line: int, row: dict[str, str], column: str, lowest: float, highest: float
) -> float:
    text = (row[column] or "").strip()
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value) or not lowest <= value <= highest:
        accepted = "above 0" if 0.0 < lowest < 1e-300 else f"from {lowest:g}"
        raise InputError(
            f"{path}, line {line}: {column} is {text or 'empty'!r}, accepted is a number "
            f"{accepted} to {highest:g}"
        )
    return value
