"""One table model: titled columns, rows and notes; in a terminal, as JSON, and in a page.

`print_table` and `json_rows` are here; pages draw tables with `results.report.page`.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from math import isfinite
from operator import attrgetter
from typing import Final, Literal, NamedTuple, TypeAlias

from rich.console import Console
from rich.text import Text

from bus_schemas.errors import printable

WIDTH: Final = 100
"""Columns of a terminal that a table uses at most."""

_GAP: Final = 2
_HEADING: Final = 9
"""Headings wrap to this width, or to the width of their column if that is larger."""
_WORDS: Final = 24
"""A column of words may wrap once it is wider than this."""


class Number(NamedTuple):
    """A number in a column whose rows have different decimals. None prints as a hyphen."""

    value: float | None
    decimals: int


Cell: TypeAlias = str | int | float | bool | Number | None
"""A bool prints as PASS or FAIL, None and NaN as a hyphen."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; only words, which stand to the left, wrap.

    A key column tells rows apart: every part of a table that had to be split repeats it. `name` is
    that of JSON, by default the title.
    """

    title: str
    unit: str = ""
    decimals: int = 3
    align: Literal["left", "right"] = "right"
    key: bool = False
    name: str = ""


def key_column(title: str, name: str = "") -> Column:
    """Return a column of words that tells rows apart."""
    return Column(title, align="left", key=True, name=name)


def word_column(title: str, name: str = "") -> Column:
    """Return a column of words, such as a note."""
    return Column(title, align="left", name=name)


def attributes(things: Iterable[object], columns: Sequence[Column]) -> list[tuple[Cell, ...]]:
    """Return a row for each thing: its attributes by the names of the columns, such as `a.b`."""
    getters = [attrgetter(column.name or column.title) for column in columns]
    return [tuple(getter(thing) for getter in getters) for thing in things]


def texts_table(title: str, lines: Iterable[tuple[str, str]]) -> Table:
    """Return a table of names and texts."""
    rows = tuple((name.capitalize(), text) for name, text in lines)
    return Table(title, (key_column("", "what"), word_column("", "found")), rows)


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its title, its columns, one row for each thing, and notes on how to read it."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()

    def names(self) -> list[str]:
        return [column.name or column.title for column in self.columns]

    def texts(self) -> list[tuple[str, ...]]:
        return [
            tuple(cell_text(*pair) for pair in zip(row, self.columns, strict=True))
            for row in self.rows
        ]

    def parts(self, width: int) -> list[Table]:
        """Split a table into as many as it takes for each to fit; all have the key columns.

        A column that says nothing in any row is left out.
        """
        texts = self.texts()
        says = [
            at
            for at, column in enumerate(self.columns)
            if column.key or not texts or _says(texts, at)
        ]
        return self._only(says)._fitting(width)

    def _fitting(self, width: int) -> list[Table]:
        widths = [least + _GAP for least in self.widths()]
        keys = [at for at, column in enumerate(self.columns) if column.key]
        groups: list[list[int]] = [[]]
        for at, column in enumerate(self.columns):
            if column.key:
                continue
            if groups[-1] and sum(widths[one] for one in (*keys, *groups[-1], at)) > width + _GAP:
                groups.append([])
            groups[-1].append(at)
        return [self._only(sorted(keys + group)) for group in groups]

    def _only(self, places: list[int]) -> Table:
        columns = [self.columns[at] for at in places]
        return replace(
            self, columns=columns, rows=[[row[at] for at in places] for row in self.rows]
        )

    def widths(self) -> list[int]:
        """Return the least width of each column."""
        widths, rows = [], self.texts()
        for at, column in enumerate(self.columns):
            texts = [row[at] for row in rows]
            longest = max(map(len, texts), default=0)
            if column.align == "left":
                words = (len(word) for text in texts for word in text.split())
                longest = max(min(longest, _WORDS), *words, 0)
            widths.append(max(longest, *map(len, _heading(column, longest)), 0))
        return widths


def _says(texts: Sequence[tuple[str, ...]], at: int) -> bool:
    return any(row[at] not in {"-", ""} for row in texts)


def counted(number: int, noun: str) -> str:
    """Return `1 cycle`, `2 cycles`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def cell_text(cell: Cell, column: Column) -> str:
    """Return a cell as it stands in a terminal and in a page."""
    if isinstance(cell, str):
        return printable(cell)
    if isinstance(cell, bool):
        return "PASS" if cell else "FAIL"
    value, decimals = cell if isinstance(cell, Number) else (cell, column.decimals)
    if value is None or not isfinite(value):
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:z,.{decimals}f}"


def print_table(console: Console, table: Table) -> None:
    """Print a table, whole: where it is too wide, its parts stand below one another."""
    width = min(console.width, WIDTH)
    console.print(Text(printable(table.title), "bold"), width=width)
    for number, part in enumerate(table.parts(width) if table.rows else ()):
        console.print("\n" * (number > 0), end="")
        console.print(_drawn(part, width), no_wrap=True, overflow="ignore", crop=False)
    for note in table.notes:
        console.print(Text(printable(note), "dim"), width=width)
    console.print()


def json_rows(table: Table) -> list[dict[str, str | float | bool | None]]:
    """Return a row of a table as a JSON object by column name; numbers keep all their digits."""
    return [dict(zip(table.names(), map(_json_cell, row), strict=True)) for row in table.rows]


def console_for(json: str | None) -> Console:
    """Return the console for tables; standard error if the JSON goes to standard output."""
    console = Console(stderr=json == "-")
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = WIDTH
    return console


def _json_cell(cell: Cell) -> str | float | bool | None:
    value = cell.value if isinstance(cell, Number) else cell
    return None if isinstance(value, float) and not isfinite(value) else value


def _drawn(table: Table, width: int) -> Text:
    """Return a table as lines of text; the tables of rich take several times as long."""
    texts, least = table.texts(), table.widths()
    widths = [max(size, *map(len, column)) for size, *column in zip(least, *texts, strict=True)]
    gaps = _GAP * (len(widths) - 1)
    while sum(widths) + gaps > width and widths != least:  # Only words give way: they can wrap.
        wide = [at for at, size in enumerate(widths) if size > least[at]]
        widths[max(wide, key=widths.__getitem__)] -= 1
    left = [column.align == "left" for column in table.columns]

    def lines(cells: Iterable[Sequence[str]]) -> Iterator[str]:
        for words in zip_longest(*cells, fillvalue=""):
            aligned = (
                word.ljust(size) if is_left else word.rjust(size)
                for word, size, is_left in zip(words, widths, left, strict=True)
            )
            yield (" " * _GAP).join(aligned) + "\n"

    drawn = Text()
    if any(column.title for column in table.columns):
        # Short headings stand at the bottom of long ones.
        upwards = lines(_heading(*pair)[::-1] for pair in zip(table.columns, least, strict=True))
        drawn.append("".join(reversed(list(upwards))), "bold")
        drawn.append("─" * (sum(widths) + gaps) + "\n")
    for row in texts:
        cells = (
            (text,) if len(text) <= size else textwrap.wrap(text, size, break_on_hyphens=False)
            for text, size in zip(row, widths, strict=True)
        )
        drawn.append("".join(lines(cells)))
    drawn.right_crop()
    drawn.highlight_regex(r"\bPASS\b", "green")
    drawn.highlight_regex(r"\bFAIL\b", "bold red")
    return drawn


def _heading(column: Column, width: int) -> list[str]:
    """Return the lines of a heading, at most as wide as the column where its words allow it."""
    return [
        line
        for text in (column.title, column.unit)
        for line in textwrap.wrap(text, max(width, _HEADING), break_long_words=False)
    ]
