"""Writes the tables of a recording, each into a file of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import Final, Protocol, TypeAlias

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from recordings.export.records import Record
from recordings.export.tables import Row, Table, tables_of
from recordings.record.writer import ClockAnchor

_BATCH: Final = 4096
"""Rows that are handed on at once."""


class TableFile(Protocol):
    """A table that is being written."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write some rows."""

    def close(self) -> None:
        """Write what is left and close the file."""


OpenTable: TypeAlias = Callable[[Path, Table, RunPlan], TableFile]


class TableFiles:
    """A folder of tables that is being written.

    Parameters
    ----------
    folder
        Where to put them; there is none yet.
    plan
        Of the run.
    signals
        Those whose messages will come.
    anchor
        Of the recording's clocks.
    open_table
        Makes a file of the format that is wanted.
    suffix
        What the names of the files end in.

    Attributes
    ----------
    rows
        Number of rows so far, by the name of the table.
    """

    def __init__(
        self,
        folder: Path,
        plan: RunPlan,
        signals: tuple[Signal[Message], ...],
        anchor: ClockAnchor,
        open_table: OpenTable,
        suffix: str,
    ) -> None:
        folder.mkdir()
        self._tables = tables_of(signals, plan, anchor)
        own = [table for tables in self._tables.values() for table in tables[:-1]]
        common = next(iter(self._tables.values()))[-1]
        every = {table.name: table for table in (*own, common)}
        self.rows = dict.fromkeys(every, 0)
        self._waiting: dict[str, list[Row]] = {name: [] for name in every}
        with ExitStack() as opened:
            self._files = {
                name: opened.enter_context(
                    closing(open_table(folder / f"{name}{suffix}", table, plan))
                )
                for name, table in every.items()
            }
            self._opened = opened.pop_all()

    def add(self, record: Record) -> None:
        """Write the rows that a record comes to."""
        for table in self._tables[record.port.signal]:
            waiting = self._waiting[table.name]
            waiting.extend(table.rows(record))
            if len(waiting) >= _BATCH:
                self._hand_on(table.name)

    def __enter__(self) -> TableFiles:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._opened:
            if error is None:
                for name in self._waiting:
                    self._hand_on(name)

    def _hand_on(self, name: str) -> None:
        rows = self._waiting[name]
        if rows:
            self._files[name].write(rows)
            self.rows[name] += len(rows)
            self._waiting[name] = []
