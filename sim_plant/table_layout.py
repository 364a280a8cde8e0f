"""How a table in a text file is laid out: encoding, separator, decimal mark, header, units.

Found in the first lines, since loggers, archives and spreadsheets write what they like. Whatever is
not the plainest form is said in a note.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bus_schemas.errors import InputError

MISSING: Final = (
    *("", "nan", "na", "n/a", "#n/a", "<na>", "null", "none", "-", "--", "---", "?", "no data"),
    *("nodata", "no-data", "missing", "#div/0!", "#value!", "#ref!", "#num!", "-nan", "n.a."),
    *("unavailable", "unknown", "bad", "error"),
)
"""What programs write where a value is missing, in lower case."""

_BINARY: Final = {
    b"PK\x03\x04": "an Excel or zip file: save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel file: save the sheet as CSV",
    b"\x1f\x8b": "a compressed file: unpack it first",
    b"PAR1": "a Parquet file: write it as CSV",
    b"\x89HDF": "an HDF5 or netCDF file: write it as CSV",
}
_NAMED: Final = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", r"\s+": "spaces"}
_LOOKED_AT: Final = 65_536
"""Bytes of a file from which its layout is found."""

_NUMBER: Final = re.compile(r"[+-]?(\d[\d.,]*|[.,]\d+)([eE][+-]?\d+)?")
_DATE: Final = re.compile(
    r"\d{4}[-/.]\d{1,2}[-/.]\d|\d{1,2}[-/.]\d{1,2}[-/.]\d\d|\d{8}[T .]\d{4}"
    r"|\d{1,2}[- ]?[A-Za-z]{3,9}[- ,]*\d{2,4}|[A-Z][a-z]{2} \d{1,2}, \d{4}"
)
_CLOCK: Final = re.compile(r"\d{1,2}:\d\d")
_PROCESS: Final = {"", "avg", "smp", "max", "min", "tot", "ts", "rn", "utc", "gmt", "local", "-"}
_FACTORS: Final = {
    **{"wm2": 1.0, "wm-2": 1.0, "wsqm": 1.0, "kwm2": 1e3, "kwm-2": 1e3},
    **{"mwcm2": 10.0, "mwcm-2": 10.0},
}
_OTHER_UNIT: Final = re.compile(
    r"m?[AV]|[kM]?Wh?(/.*)?|k?V?A|[kM]?J/.*|k?lux|°?[CFK]|deg.*|%|m/s|k?Pa|mbar|s|sec|min|h"
    r"|ISO ?8601|[Yy]{4}.*|[Dd]{2}.*|[Hh]{2}:.*|[Mm]{2}/.*"
)
_ALIASES: Final = {
    "station": ("name", "id", "sensor", "site", "station_id", "station name", "location"),
    "inverter": ("name", "id"),
    "lat": ("latitude", "lat_deg"),
    "lon": ("longitude", "lng", "long", "lon_deg"),
}
"""Other names of the columns that a reader needs."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the values of a file begin, the first of them, and how they are written."""

    encoding: str
    separator: str
    decimal: str
    thousands: str | None
    header: tuple[str, ...]
    units: tuple[str, ...]
    first_line: int
    first: tuple[str, ...]
    notes: tuple[str, ...] = ()


def irradiance_factor(unit: str) -> float | None:
    """Return by what an irradiance in a unit is multiplied for W/m2; None: it is none."""
    plain = unit.replace("²", "2").replace("⁻", "-").lower()
    return _FACTORS.get(re.sub(r"[\s^*/·_.]", "", plain))


def _is_unit(text: str) -> bool:
    return irradiance_factor(text) is not None or _OTHER_UNIT.fullmatch(text) is not None


def name_and_unit(cell: str) -> tuple[str, str]:
    """Split `Global PSP [W/m^2]` into name and unit; brackets without a unit stay in the name."""
    found = re.fullmatch(r"(.*\S)\s*[\[(]([^][()]*)[\])]", cell)
    return (found[1], found[2].strip()) if found and _is_unit(found[2].strip()) else (cell, "")


def is_date(cell: str) -> bool:
    return _DATE.match(cell) is not None


def is_clock(cell: str) -> bool:
    return _CLOCK.match(cell) is not None


def find_layout(path: Path, needed: Collection[str] = ()) -> Layout:
    """Find the layout of a file; the header has all names that are needed, in any case."""
    encoding, text = _decoded(path)
    lines = text.splitlines()
    tables = {separator: _cells(lines, separator) for separator in _NAMED}
    found = [
        (len(rows[place[0] or 0]), separator, *place)
        for separator, rows in tables.items()
        if (place := _named_header(rows, needed) if needed else _any_header(rows)) is not None
    ]
    if not found:
        got = ", ".join(re.split(r"\s*[,;\t|]\s*", lines[0]))[:200]
        expected = f"the columns {', '.join(needed)}" if needed else "a header, then values"
        raise InputError(f"{path.name}: line 1: expected {expected}, got {got}")
    # The widest; spaces are in time stamps and names, too.
    _, separator, head, first = max(found, key=lambda one: (one[1] != r"\s+", one[0]))
    rows = tables[separator]
    values = tuple(rows[first]) if first < len(rows) else ()
    notes = [] if separator == "," else [f"values are separated by {_NAMED[separator]}"]
    if head is None:
        header = [str(number) for number in range(1, len(values) + 1)]
        notes.append("there is no header: columns are named 1, 2 and so on")
    else:
        header = [rows[head][0].lstrip("# "), *rows[head][1:]]
        if len(header) == len(values) - 1 and values[-1]:  # R does not name the first column.
            header.insert(0, "")
        if first != 1:
            notes.append(f"the header is line {head + 1}, the first values are in line {first + 1}")
    width = max(len(header), len(values))
    above = rows[head + 1 : first] if head is not None else []
    units = next((row for row in above if any(map(_is_unit, row))), [])
    decimal, thousands = _marks(path, separator, rows[first:])
    if decimal == ",":
        notes.append("the decimal mark is a comma")
    if encoding not in {"utf-8", "utf-8-sig"}:
        notes.append(f"read as {encoding}")
    padded = [tuple([*some, *[""] * width][:width]) for some in (header, units)]
    return Layout(
        encoding, separator, decimal, thousands, padded[0], padded[1], first, values, tuple(notes)
    )


def _decoded(path: Path) -> tuple[str, str]:
    """Return the encoding of a file, and its first lines."""
    if path.exists() and not path.is_file():  # A pipe would be waited for.
        raise InputError(f"{path}: expected a CSV file, got no regular file")
    try:
        with path.open("rb") as file:
            start = file.read(_LOOKED_AT)
    except OSError as error:
        raise InputError(f"{path}: expected a CSV file, got: {error.strerror}") from None
    other = next((what for magic, what in _BINARY.items() if start.startswith(magic)), None)
    if other or not start.strip():
        raise InputError(f"{path}: expected a CSV file, got {other or 'an empty one'}")
    encoding = "utf-16" if start[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig"
    text = start.decode(encoding, errors="replace")
    if "\ufffd" in text[:-1]:  # The last character may be cut in two.
        encoding = "cp1252"
        text = start.decode(encoding, errors="replace")
    if "\0" in text:
        raise InputError(f"{path}: expected a CSV file, got no text")
    return encoding, text if len(start) < _LOOKED_AT else text[: text.rfind("\n") + 1]


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    if separator == r"\s+":
        return [line.split() or [""] for line in lines]
    rows = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    return [[cell.strip() for cell in row] or [""] for row in rows]


def _named_header(rows: list[list[str]], needed: Collection[str]) -> tuple[int | None, int] | None:
    """Return where the header with some names is, and where the values begin."""
    for head, row in enumerate(rows[:200]):
        if all(named(row, name) is not None for name in needed):
            below = range(head + 1, len(rows))
            return head, next((at for at in below if not _is_units(rows[at])), head + 1)
    return None


def _any_header(rows: list[list[str]]) -> tuple[int | None, int] | None:
    """Return where the header is, None where there is none, and where the values begin."""
    found = [at for at, row in enumerate(rows[:200]) if len(row) > 1 and _is_values(row)]
    if not found:
        return None
    width = Counter(len(rows[at]) for at in found).most_common(1)[0][0]
    first = next(at for at in found if len(rows[at]) == width)
    head = first - 1
    while head >= 0 and (_is_units(rows[head]) or abs(len(rows[head]) - width) > 1):
        head -= 1
    return (head if head >= 0 and head not in found else None), first


def named(header: Sequence[str], name: str) -> int | None:
    """Return the column of a name, in any case, or of another name for it."""
    plain = [name_and_unit(cell.lstrip("# "))[0].strip().lower() for cell in header]
    return next((plain.index(one) for one in (name, *_ALIASES.get(name, ())) if one in plain), None)


def _is_values(row: Sequence[str]) -> bool:
    """Whether a row begins with a time, or has numbers, and else times or one full time stamp."""
    given = [cell for cell in row if cell.lower() not in MISSING]
    stamps = [cell for cell in given if is_date(cell) or is_clock(cell)]
    if stamps and stamps[0] == row[0]:
        return True
    numbers = [cell for cell in given if _NUMBER.fullmatch(cell) and cell not in stamps]
    is_full = any(":" in cell and "-" in cell for cell in stamps)
    return bool(numbers) and (is_full or len(numbers) + len(stamps) == len(given))


def _is_units(row: Sequence[str]) -> bool:
    return all(cell.lower() in _PROCESS or _is_unit(cell.strip("[]()")) for cell in row)


def _marks(path: Path, separator: str, rows: Sequence[Sequence[str]]) -> tuple[str, str | None]:
    """Return the decimal mark, and the mark between thousands where there is one."""
    cells = [cell for row in rows for cell in row if _NUMBER.fullmatch(cell)]

    def like(form: str) -> list[str]:
        return [cell for cell in cells if re.fullmatch(rf"[+-]?{form}([eE][+-]?\d+)?", cell)]

    if like(r"\d{1,3}(\.\d{3})+,\d+"):
        return ",", "."
    comma, point = like(r"\d*,\d+"), like(r"\d*\.\d+")
    is_quoted = separator == "," and comma and all(re.fullmatch(r"\d,\d{3}", one) for one in comma)
    if is_quoted or like(r"\d{1,3}(,\d{3})+\.\d+"):
        return ".", ","
    if comma and point:
        raise InputError(
            f"{path.name}: expected one decimal mark, got both, {comma[0]} and {point[0]}"
        )
    return ("," if comma else "."), None
