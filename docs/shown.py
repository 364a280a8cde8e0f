"""Puts measured tables and figures into pages, between comments that name them.

`<!-- measured: NAME where COLUMN is VALUE or VALUE and ... -->` ... `<!-- end -->` shows a table,
or only some of its rows; a column with one value is left out. README names the table's page, too.
`<!--NAME-->5.2<!--/-->` shows a figure, a row of `figures.csv`;
`<!--TABLE:KEY:KEY:COLUMN-->5.2<!--/-->` shows one cell of another table, in the row that begins
with the keys. So no number of a page is its own, and a page is read as it is also where no site is
built. A test compares.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final

DOCUMENTS: Final = Path(__file__).parent
TABLES: Final = DOCUMENTS / "tables"
PAGES: Final = (DOCUMENTS.parent / "README.md", *sorted(DOCUMENTS.rglob("*.md")))

_TABLE: Final = re.compile(
    r"(<!-- measured: (?P<name>[A-Za-z ]+?)(?: where (?P<where>.+?))? -->\n).*?(<!-- end -->)",
    re.DOTALL,
)
_CELL: Final = re.compile(r"(<!--(?P<place>[^-\s/][^>]*?)-->).*?(<!--/-->)")


Found = Iterator[tuple[str, str, str]]
"""Name, value and unit of figures."""


def keep(command: str, found: Found) -> None:
    """Put figures into the file, in place of older ones, and into the pages."""
    date = datetime.now(UTC).date().isoformat()
    rows = {name: row for name, *row in read("figures")[1:]}
    rows |= {name: [value, unit, command, date] for name, value, unit in found}
    head = ("name", "value", "unit", "command", "date")
    write("figures", [head, *([name, *row] for name, row in sorted(rows.items()))])
    fill()


def filled(page: Path, text: str) -> str:
    """Return a page with the tables and figures that it shows as they are now."""
    text = _CELL.sub(lambda found: f"{found[1]}{cell(found['place'])}{found[3]}", text)
    return _TABLE.sub(partial(_with_rows, page.stem), text)


def fill(pages: Iterable[Path] = PAGES) -> None:
    for page in pages:
        page.write_text(filled(page, page.read_text(encoding="utf-8")), encoding="utf-8")


def read(table: str) -> list[list[str]]:
    with (TABLES / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def write(table: str, rows: Iterable[Iterable[object]]) -> None:
    with (TABLES / f"{table}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def cell(place: str) -> str:
    """Return a cell: `TABLE:KEY:...:COLUMN`, or the name of a figure."""
    table, *keys, column = place.split(":") if ":" in place else ["figures", place, "value"]
    titles, *rows = read(table)
    (row,) = (cells for cells in rows if cells[: len(keys)] == keys)
    return _grouped(row[titles.index(column)])


def _with_rows(page: str, found: re.Match[str]) -> str:
    name = found["name"].replace(" ", "-")
    titles, *rows = read(name if page == "README" else f"{page}-{name}")
    for condition in filter(None, (found["where"] or "").split(" and ")):
        column, _, among = condition.partition(" is ")
        at, values = titles.index(column), among.split(" or ")
        rows = [cells for cells in rows if cells[at] in values]
        if len(values) == 1:
            titles, *rows = ([*cells[:at], *cells[at + 1 :]] for cells in (titles, *rows))
    lines = [f"| {' | '.join(map(_grouped, cells))} |\n" for cells in (titles, *rows)]
    shown = "".join([lines[0], "|" + "---|" * len(titles) + "\n", *lines[1:]])
    return f"{found[1]}{shown}{found[4]}"


def _grouped(cell: str) -> str:
    """Write a whole number with commas between its thousands."""
    return f"{int(cell):,}" if cell.isdecimal() else cell
