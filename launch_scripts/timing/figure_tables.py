"""Tables of figures in a terminal: where one is too narrow for a table, it becomes several.

No figure is ever cut, and none is left out: a cut verdict is none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

from rich.console import Console
from rich.table import Table
from rich.text import Text

WIDTH: Final = 100
"""The widest that a table becomes, so that names and figures stay close to each other."""

_GAP: Final = 1


class Column(NamedTuple):
    """A column of figures.

    Attributes
    ----------
    heading
        Its heading, in one line or two.
    width
        How wide it is where there is room: so tables line up.
    """

    heading: str
    width: int


Row: TypeAlias = Sequence[str]
"""A name, and a figure for each column; with rich's markup."""


def print_table(
    console: Console, title: str, columns: Sequence[Column], rows: Sequence[Row]
) -> None:
    """Print a table under its title: in one piece, or in as many as the terminal needs.

    Parameters
    ----------
    console
        Where to.
    title
        What it shows; with rich's markup.
    columns, rows
        See `Column` and `Row`.
    """
    console.print(f"\n{title}", highlight=False)
    if not rows:
        return
    for table in _pieces(columns, rows, console.width):
        console.print(table)


def _pieces(columns: Sequence[Column], rows: Sequence[Row], width: int) -> Iterator[Table]:
    name_width = max(_width(row[0]) for row in rows)
    least = [
        max(_width(column.heading), *(_width(row[place]) for row in rows))
        for place, column in enumerate(columns, start=1)
    ]
    wished = [max(column.width, own) for column, own in zip(columns, least, strict=True)]
    every = range(len(columns))
    at_most = min(width, WIDTH)
    if name_width + _taken(wished) <= at_most:
        yield _table(columns, rows, every, wished, at_most - _taken(wished))
    elif name_width + _taken(least) <= width:
        yield _table(columns, rows, every, least, name_width)
    else:
        name_width = max(min(name_width, width - _taken([max(least)])), 1)
        for group in _groups(least, width - name_width):
            yield _table(columns, rows, group, least, name_width)


def _groups(widths: Sequence[int], width: int) -> Iterator[Sequence[int]]:
    """Yield the places of columns that stand side by side, in their order."""
    group: list[int] = []
    for place, own in enumerate(widths):
        if group and _taken([widths[member] for member in group]) + _GAP + own > width:
            yield group
            group = []
        group.append(place)
    yield group


def _table(
    columns: Sequence[Column],
    rows: Sequence[Row],
    places: Sequence[int],
    widths: Sequence[int],
    name_width: int,
) -> Table:
    table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="")
    table.add_column(width=name_width, overflow="fold")
    for place in places:
        table.add_column(
            columns[place].heading, justify="right", width=widths[place], overflow="fold"
        )
    for row in rows:
        table.add_row(row[0], *(row[place + 1] for place in places))
    return table


def _taken(widths: Sequence[int]) -> int:
    """Return how much columns take, with the gaps before them."""
    return sum(widths) + _GAP * len(widths)


def _width(markup: str) -> int:
    return max((line.cell_len for line in Text.from_markup(markup).split("\n")), default=0)
