"""No figure of a table is cut."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from studies.timing.figure_tables import Column, FigureTable, page_table, print_table

COLUMNS = (Column("count", 8), Column("p99\nat most", 9), Column("", 4))
ROWS = [
    ("direct estimate", "1,234,567", "3,607,772.0", "FAIL"),
    ("plant", "7", "8.5", "PASS"),
]


@pytest.mark.parametrize("width", [44, 60, 80, 100, 200])
def test_where_there_is_room_each_figure_stands_whole(width: int) -> None:
    console = Console(file=io.StringIO(), width=width)
    print_table(console, FigureTable("decision", " [ms]: of a stage", COLUMNS, ROWS))
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= min(width, 100)
    for figure in ("1,234,567", "3,607,772.0", "FAIL", "7", "8.5", "PASS", "decision", "[ms]:"):
        assert text.split().count(figure) == 1


def test_without_rows_there_is_a_title() -> None:
    console = Console(file=io.StringIO(), width=80)
    print_table(console, FigureTable("floor", "", COLUMNS, []))
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == "\nfloor\n"


def test_a_page_has_the_same_figures() -> None:
    table = page_table(FigureTable("decision", " [ms]", COLUMNS, ROWS))
    assert table.columns == ("count", "p99 at most", "")
    assert table.rows[1] == ("plant", "", ("7", "8.5", "PASS"))
