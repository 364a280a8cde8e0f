"""Tables of figures, for a terminal and for a page alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from studies.report.tables import ReportTable

WIDTH: Final = 100
"""The widest that a table becomes in a terminal, so that names and figures stay close together."""

_RED: Final = frozenset({"FAIL", "not clean", "failed"})


class Column(NamedTuple):
    """A column of figures: its heading, and how wide it is at least, so that tables line up."""

    heading: str
    width: int


Row: TypeAlias = tuple[str, ...]
"""A name, and a figure for each column."""


class FigureTable(NamedTuple):
    """A table: its title, what its figures are, its columns and rows."""

    title: str
    meaning: str
    columns: Sequence[Column]
    rows: Sequence[Row]


def console_for(json: str | None) -> Console:
    """Return the console to print to; with the JSON on standard output that is standard error."""
    console = Console(stderr=json == "-")
    return console if console.is_terminal else Console(stderr=json == "-", width=WIDTH)


def print_table(console: Console, table: FigureTable) -> None:
    """Print a table under its title. Where there is no room, figures fold and are not cut."""
    console.print(f"\n[bold]{escape(table.title)}[/]{escape(table.meaning)}", highlight=False)
    if not table.rows:
        return
    width = min(console.width, WIDTH)
    shown = Table(
        box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="", expand=True, width=width
    )
    shown.add_column(ratio=1, overflow="fold")
    for column in table.columns:
        shown.add_column(
            escape(column.heading), justify="right", min_width=column.width, overflow="fold"
        )
    for name, *figures in table.rows:
        cells = (f"[bold red]{text}[/]" if text in _RED else escape(text) for text in figures)
        shown.add_row(f"  {escape(name)}", *cells)
    console.print(shown)


def page_table(table: FigureTable) -> ReportTable:
    """Return a table as a page has it."""
    columns = tuple(column.heading.replace("\n", " ") for column in table.columns)
    rows = tuple((name, "", tuple(figures)) for name, *figures in table.rows)
    heading = f"{table.title[0].upper()}{table.title[1:]}"
    return ReportTable(heading, columns, rows, table.meaning.strip(" :,"))
