"""One table model: whole in every terminal, complete in JSON."""

from __future__ import annotations

from math import nan

import pytest
from printing import printed

from results.tables import Column, Number, Table, json_rows, key_column, print_table, word_column


def many_columns(columns: int) -> Table:
    """Return two cases with a figure in each of many columns."""
    return Table(
        "Cases",
        (
            key_column("Case", "case"),
            *(Column(f"Figure number {n}", "kWh", 1, name=f"f{n}") for n in range(columns)),
        ),
        (
            ("seed 1, share 0.6", *(1000.0 + n for n in range(columns))),
            ("seed 2, share 0.6", *(2000.0 + n for n in range(columns))),
        ),
        ("A note.",),
    )


def lines_of(table: Table, width: int) -> list[str]:
    return printed(lambda console: print_table(console, table), width).splitlines()


@pytest.mark.parametrize("width", [100, 80, 50, 30])
@pytest.mark.parametrize("columns", [1, 7, 30])
def test_every_cell_is_printed_beside_what_tells_its_row_apart(width: int, columns: int) -> None:
    lines = lines_of(many_columns(columns), width)
    assert max(map(len, lines)) <= width
    for n in range(columns):
        (first,) = [line for line in lines if f"{1000 + n:,}.0" in line]
        (second,) = [line for line in lines if f"{2000 + n:,}.0" in line]
        assert first.startswith("seed 1, share 0.6")
        assert second.startswith("seed 2, share 0.6")


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (1234.5678, "1,234.568"),
        (Number(1234.5678, 1), "1,234.6"),
        (1234, "1,234"),
        (None, "-"),
        (nan, "-"),
        (Number(None, 2), "-"),
        (True, "PASS"),
        (False, "FAIL"),
        ("[b]as it is[/b]", "[b]as it is[/b]"),
    ],
)
def test_cells_as_text(cell: float | str | None, text: str) -> None:
    table = Table("", (key_column("Value"),), ((cell,),))
    assert table.texts() == [(text,)]
    assert text in " ".join(lines_of(table, 80))


def test_json_has_all_digits_and_no_nan() -> None:
    columns = (key_column("Case", "case"), Column("Energy", "kWh", name="energy"), Column("Score"))
    table = Table("", columns, (("a", 1.23456789, nan), ("b", Number(0.1 + 0.2, 1), None)))
    assert json_rows(table) == [
        {"case": "a", "energy": 1.23456789, "Score": None},
        {"case": "b", "energy": 0.1 + 0.2, "Score": None},
    ]


def test_a_column_that_says_nothing_is_not_printed_but_is_in_the_json() -> None:
    columns = (key_column("Case"), Column("Energy"), Column("Score"), word_column("Note"))
    table = Table("", columns, (("a", 1.0, None, ""), ("b", None, nan, "")))
    heading = lines_of(table, 80)[1]
    assert heading.split() == ["Case", "Energy"]
    assert [*json_rows(table)[0]] == ["Case", "Energy", "Score", "Note"]
