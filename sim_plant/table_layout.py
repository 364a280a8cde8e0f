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
    *("nodata", "no-data", "missing", "#div/0!", "#value!", "#ref!", "#num!", "-nan", "1.#ind"),
    *("-1.#ind", "n.a.", "unavailable", "unknown", "bad", "error", "inf_missing"),
)
"""What programs write where a value is missing, in lower case."""

_BINARY: Final = {
    b"PK\x03\x04": "an Excel or zip file: save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel file: save the sheet as CSV",
    b"\x1f\x8b": "a compressed file: unpack it first",
    b"PAR1": "a Parquet file: write it as CSV",
    b"\x89HDF": "an HDF5 or netCDF file: write it as CSV",
    b"CDF\x01": "a netCDF file: write it as CSV",
    b"%PDF": "a PDF file",
}
_NAMED: Final = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", r"\s+": "spaces"}
_SNIFFED: Final = 65_536
"""Bytes of a file from which its layout is found."""

_NUMBER: Final = re.compile(r"[+-]?(\d[\d.,]*|[.,]\d+)([eE][+-]?\d+)?")
_TIME: Final = re.compile(
    r"(\d{4}-\S+/(?=\d{4}-))?"
    r"(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{1,2}[- ]?[A-Za-z]{3,9}[- ,]*\d{2,4}|\d{8}(?=[T ]))?"
    r"[T ,]*(\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?|(?<=[T ])\d{4,6})?\s*([AaPp][Mm])?\s*"
    r"(Z|UTC|GMT|[+-]\d{2}(:?\d{2})?|[A-Z]{3,4})?"
)
_PROCESS: Final = {"avg", "smp", "max", "min", "tot", "std", "ts", "rn", "utc", "gmt", "local", "-"}
_FACTORS: Final = {
    **{"wm2": 1.0, "wm-2": 1.0, "wsqm": 1.0, "kwm2": 1e3, "kwm-2": 1e3},
    **{"mwcm2": 10.0, "mwcm-2": 10.0},
}
_OTHER_UNIT: Final = re.compile(
    r"m?[AV]|[km]?Wh?|MWh?|k?V?A|Hz|°?[CFK]|deg ?C?|degrees?( [NE])?|%|m/s|mm?|k?Pa|mbar|[kM]?J/.*"
    r"|k?Wh/.*|s|sec|seconds?|min|h|ISO ?8601|[Yy]{4}.*|[Dd]{2}.*|[Hh]{2}:.*|[Mm]{2}/.*|pu|p\.u\."
)
_ALIASES: Final = {
    "station": ("name", "id", "sensor", "site", "station_id", "station name", "location"),
    "inverter": ("name", "id"),
    "lat": ("latitude", "lat_deg", "y_lat"),
    "lon": ("longitude", "lng", "long", "lon_deg"),
}
"""Other names of the columns that a reader needs."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the rows of a file begin, and how they are written."""

    encoding: str
    separator: str
    decimal: str
    thousands: str | None
    header: tuple[str, ...]
    units: tuple[str, ...]
    first_line: int
    sample: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


def irradiance_factor(unit: str) -> float | None:
    """Return by what an irradiance in a unit is multiplied for W/m2; None: it is none."""
    plain = unit.replace("²", "2").replace("⁻", "-").lower()
    return _FACTORS.get(re.sub(r"[\s^*/·_.]", "", plain))


def _is_unit(text: str) -> bool:
    return irradiance_factor(text) is not None or _OTHER_UNIT.fullmatch(text) is not None


def name_and_unit(cell: str) -> tuple[str, str]:
    """Split `Global PSP [W/m^2]` into name and unit; brackets without a unit stay in the name."""
    found = re.fullmatch(r"(.*\S)\s*(?:\[([^][]*)\]|\(([^()]*)\))", cell)
    unit = (found[2] or found[3] or "").strip() if found else ""
    return (found[1], unit) if found and _is_unit(unit) else (cell, "")


def find_layout(path: Path, needed: Collection[str] = ()) -> Layout:
    """Find the layout of a file; the header has all names that are needed, in any case."""
    encoding, text = _decoded(path)
    lines = text.splitlines()
    found = [
        (separator, *place)
        for separator in _NAMED
        if (place := _places(_cells(lines, separator), needed)) is not None
    ]
    if not found:
        return _of_plain_lines(path, encoding, lines, needed)
    separator, rows, head, first = max(found, key=lambda one: len(one[1][one[2] or 0]))
    notes = [] if separator == "," else [f"values are separated by {_NAMED[separator]}"]
    width = max(len(rows[head or 0]), *(len(row) for row in rows[first : first + 1]), 1)
    header = _header(rows, head, width, rows[first] if first < len(rows) else [""])
    above = rows[head + 1 : first] if head is not None else []
    units = next((row for row in above if any(map(_is_unit, row))), ())
    if head is None:
        notes.append("there is no header: columns are named 1, 2 and so on")
    elif head or len(above):
        notes.append(f"the header is line {head + 1}, the first values are in line {first + 1}")
    sample = tuple(tuple(row) for row in rows[first:])
    decimal, thousands = _marks(path, separator, sample)
    if decimal == ",":
        notes.append("the decimal mark is a comma")
    if encoding not in {"utf-8", "utf-8-sig"}:
        notes.append(f"read as {encoding}")
    padded = tuple(units) + ("",) * (len(header) - len(units))
    return Layout(
        encoding, separator, decimal, thousands, header, padded, first, sample, tuple(notes)
    )


def _decoded(path: Path) -> tuple[str, str]:
    """Return the encoding of a file, and its first lines."""
    if path.exists() and not path.is_file():  # A pipe would be waited for.
        raise InputError(f"{path}: expected a CSV file, got no regular file")
    try:
        with path.open("rb") as file:
            start = file.read(_SNIFFED)
    except OSError as error:
        raise InputError(f"{path}: expected a CSV file, got: {error.strerror}") from None
    if not start.strip():
        raise InputError(f"{path}: expected a CSV file, got an empty one")
    for magic, what in _BINARY.items():
        if start.startswith(magic):
            raise InputError(f"{path}: expected a CSV file, got {what}")
    encoding = _encoding(start)
    text = start.decode(encoding, errors="replace")
    if "\0" in text or text.count("\x1a") > 1:
        raise InputError(f"{path}: expected a CSV file, got no text")
    return encoding, text if len(start) < _SNIFFED else text[: text.rfind("\n") + 1]


def _encoding(start: bytes) -> str:
    if start[:2] in {b"\xff\xfe", b"\xfe\xff"}:
        return "utf-16"
    if start[:400].count(0) > 100:
        return "utf-16-le" if start[1::2].count(0) > start[::2].count(0) else "utf-16-be"
    if start.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    try:
        start[: start.rfind(b"\n") + 1 or None].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    if separator == r"\s+":
        return [line.split() for line in lines]
    return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]


def _places(
    rows: list[list[str]], needed: Collection[str]
) -> tuple[list[list[str]], int | None, int] | None:
    """Return the rows, where the header is and where the values begin; None: it is no table."""
    if needed:
        for head, row in enumerate(rows[:200]):
            if all(named(row, name) is not None for name in needed):
                return rows, head, _first_after(rows, head)
        return None
    found = [at for at, row in enumerate(rows[:200]) if len(row) > 1 and _is_values(row)]
    if not found:
        return None
    width = Counter(len(rows[at]) for at in found).most_common(1)[0][0]
    first = next(at for at in found if len(rows[at]) == width)
    head = first - 1
    while head >= 0 and (_is_units(rows[head]) or abs(len(rows[head]) - width) > 1):
        head -= 1
    is_header = head >= 0 and head not in found
    return rows, head if is_header else None, first


def named(header: Sequence[str], name: str) -> int | None:
    """Return the column of a name, in any case, or of another name for it."""
    plain = [name_and_unit(cell.lstrip("# "))[0].strip().lower() for cell in header]
    known = (one for one in (name, *_ALIASES.get(name, ())) if one in plain)
    return next((plain.index(one) for one in known), None)


def _first_after(rows: list[list[str]], head: int) -> int:
    for first in range(head + 1, min(head + 20, len(rows))):
        if any(rows[first]) and not _is_units(rows[first]):
            return first
    return head + 1


def _is_values(row: Sequence[str]) -> bool:
    """Whether a row begins with a time, or holds nothing but numbers."""
    first, second = row[0].strip("# "), row[1]
    if is_time(first) or (is_time(second) and (not first or _NUMBER.fullmatch(first))):
        return True
    given = [cell for cell in row if cell.lower() not in MISSING]
    numbers = [cell for cell in given if _NUMBER.fullmatch(cell)]
    if numbers and any(":" in cell and "-" in cell and is_time(cell) for cell in given):
        return True  # A name, a value and a time.
    return bool(given) and all(_NUMBER.fullmatch(cell) or is_time(cell) for cell in given)


def is_time(text: str) -> bool:
    return bool(text) and not text.isalpha() and _TIME.fullmatch(text) is not None


def _is_units(row: Sequence[str]) -> bool:
    given = [cell for cell in row if cell]
    return all(cell.lower() in _PROCESS or _is_unit(cell.strip("[]()")) for cell in given)


def _header(
    rows: list[list[str]], head: int | None, width: int, first: Sequence[str]
) -> tuple[str, ...]:
    if head is None:
        return tuple(map(str, range(1, width + 1)))
    names = [rows[head][0].lstrip("# "), *rows[head][1:]]
    if len(names) == width - 1 and first[-1]:  # R writes no name for the first column.
        names.insert(0, "")
    return tuple(names + [""] * (width - len(names)))


def _of_plain_lines(
    path: Path, encoding: str, lines: Sequence[str], needed: Collection[str]
) -> Layout:
    """Return the layout of a file of one column, or one in which nothing was recognised."""
    names = max((_cells(lines[:1], one)[0] for one in (",", ";", "\t")), key=len, default=[""])
    if not needed and (len(names) == 1 or not any(lines[1:])):
        sample = tuple((line.strip(),) for line in lines[1:])
        units = ("",) * len(names)
        return Layout(encoding, ",", ".", None, tuple(names), units, 1, sample, ())
    expected = f"the columns {', '.join(needed)}" if needed else "a header, then lines of values"
    raise InputError(f"{path.name}: line 1: expected {expected}, got {', '.join(names)[:200]}")


def _marks(path: Path, separator: str, sample: Sequence[Sequence[str]]) -> tuple[str, str | None]:
    """Return the decimal mark, and the mark between thousands where there is one."""
    cells = [cell for row in sample for cell in row if "," in cell or "." in cell]
    cells = [cell for cell in cells if _NUMBER.fullmatch(cell)]
    comma = [cell for cell in cells if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell)]
    point = [cell for cell in cells if re.fullmatch(r"[+-]?\d*\.\d+([eE][+-]?\d+)?", cell)]
    if any(re.fullmatch(r"[+-]?\d{1,3}(\.\d{3})+,\d+", cell) for cell in cells):
        return ",", "."
    if any(re.fullmatch(r"[+-]?\d{1,3}(,\d{3})+\.\d+", cell) for cell in cells):
        return ".", ","
    if comma and point:
        raise InputError(
            f"{path.name}: expected one decimal mark, got both, {comma[0]} and {point[0]}"
        )
    if comma and separator == "," and all(re.fullmatch(r"\d,\d{3}", cell) for cell in comma):
        return ".", ","
    return ("," if comma else "."), None
