"""A table of the report, as text."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table: one row for each thing, one column for each run or scheme.

    Attributes
    ----------
    heading
        What it is.
    columns
        Heading of each column of values, for instance the control schemes.
    rows
        Of each row its name, its unit (empty for none) and one value for each column.
    note
        A sentence on how to read it, or nothing.

    Raises
    ------
    ValueError
        A row has another number of values than there are columns.
    """

    heading: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[str, ...]], ...]
    note: str = ""

    def __post_init__(self) -> None:
        for name, _, values in self.rows:
            if len(values) != len(self.columns):
                raise ValueError(
                    f"table {self.heading!r}, row {name!r}: {len(values)} values for "
                    f"{len(self.columns)} columns"
                )
