"""Tables of figures in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

from rich.console import Console
from rich.table import Table

WIDTH: Final = 100
"""The widest that a table becomes, so that names and figures stay close to each other."""


class Column(NamedTuple):
    """A column of figures: its heading, and how wide it is at least, so that tables line up."""

    heading: str
    width: int


Row: TypeAlias = Sequence[str]
"""A name, and a figure for each column; with rich's markup."""


def console_for(json: str | None) -> Console:
    """Return the console to print to; with the JSON on standard output that is standard error."""
    console = Console(stderr=json == "-")
    return console if console.is_terminal else Console(stderr=json == "-", width=WIDTH)


def print_table(
    console: Console, title: str, columns: Sequence[Column], rows: Sequence[Row]
) -> None:
    """Print a table under its title. Where there is no room, figures fold and are not cut."""
    console.print(f"\n{title}", highlight=False)
    if not rows:
        return
    width = min(console.width, WIDTH)
    table = Table(
        box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="", expand=True, width=width
    )
    table.add_column(ratio=1, overflow="fold")
    for column in columns:
        table.add_column(column.heading, justify="right", min_width=column.width, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
