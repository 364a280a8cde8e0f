"""However narrow a terminal is, each figure of a table is in it, whole."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from launch_scripts.timing.figure_tables import Column, print_table

COLUMNS = (Column("count", 8), Column("p99\nat most", 9), Column("", 4))
ROWS = [
    ("  direct estimate", "1,234,567", "3,607,772.0", "[bold red]FAIL[/]"),
    ("  plant", "7", "8.5", "PASS"),
]


def printed(width: int) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    print_table(console, "decision", COLUMNS, ROWS)
    assert isinstance(console.file, io.StringIO)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


@pytest.mark.parametrize("width", [20, 30, 42, 44, 60, 80, 100, 200])
def test_no_figure_is_cut_or_left_out(width: int) -> None:
    lines = printed(width)
    assert max(map(len, lines)) <= width
    words = " ".join(lines).split()
    for figure in ("1,234,567", "3,607,772.0", "FAIL", "7", "8.5", "PASS", "decision"):
        assert words.count(figure) == 1
    # Names, figures and the gaps between them are 44 wide; each piece has the names again.
    assert (words.count("plant") > 1) == (width < 44)


def test_where_there_is_room_the_columns_have_the_width_that_was_wished() -> None:
    narrow = [("  plant", "7", "8.5", "PASS")]
    console = Console(file=io.StringIO(), width=100)
    print_table(console, "decision", COLUMNS, narrow)
    assert isinstance(console.file, io.StringIO)
    last = console.file.getvalue().splitlines()[-1]
    assert last == f"{'  plant':<77}{'7':>8} {'8.5':>9} PASS"


def test_without_rows_there_is_a_title() -> None:
    console = Console(file=io.StringIO(), width=80)
    print_table(console, "floor", COLUMNS, [])
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == "\nfloor\n"
