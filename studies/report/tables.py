"""The old name of a report's table; use `studies.tables.Table`."""

from __future__ import annotations

from studies.tables import Column, Table, key_column, word_column


def ReportTable(  # noqa: N802
    heading: str,
    columns: tuple[str, ...],
    rows: tuple[tuple[str, str, tuple[str, ...]], ...],
    note: str = "",
) -> Table:
    """Return a table with a name, a unit and text for each column in its rows."""
    return Table(
        heading,
        (key_column(""), word_column(""), *map(Column, columns)),
        tuple((name, unit, *values) for name, unit, values in rows),
        (note,) if note else (),
    )
