"""A recording as tidy tables in CSV or Parquet: one observation in a row, one value in a cell.

Every signal has a table of its own, named after it. So has each list inside messages: help given,
the inverters of a production, the inputs that were not due. Both formats are written by
pyarrow, a batch of rows at a time, so memory does not grow with the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import pyarrow as pa
import pyarrow.compute as pc
from msgspec import inspect
from pyarrow.csv import CSVWriter
from pyarrow.parquet import ParquetWriter

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from bus_schemas.tree import agent_name
from recordings.export.viewer_file import not_nil
from recordings.read.frames import HEAD_FIELDS, LISTS, Cell, list_rows
from recordings.read.reader import RecordedMessage
from recordings.record.writer import ClockAnchor

TableForm: TypeAlias = Literal["csv", "parquet"]
Row: TypeAlias = tuple[Cell, ...]
Columns: TypeAlias = tuple[tuple[str, pa.DataType], ...]
"""Names, with the unit in them, and types. `time` [ns since 1970-01-01 UTC] and `cycle` come before
them in every table."""

BATCH_ROWS: Final = 65_536
"""Rows that are written at once: a row group of some megabytes in Parquet."""

_INT: Final = pa.int64()
_NUMBER: Final = pa.float64()
_TEXT: Final = pa.string()
_TYPE_OF: Final = {
    inspect.FloatType: _NUMBER,
    inspect.IntType: _INT,
    inspect.StrType: _TEXT,
    inspect.LiteralType: _TEXT,
}
_OF_TYPE: Final = {int: _INT, float: _NUMBER, str: _TEXT}

_OF_MESSAGES: Final[Columns] = (
    ("source", _TEXT),
    ("sequence", _INT),
    ("incarnation", _INT),
    ("ready_time_ns", _INT),
    ("publish_time_ns", _INT),
    ("log_time_ns", _INT),
)
"""Last columns of the table of every signal."""


def _own_columns(signal: Signal[Message]) -> Columns:
    """Columns for the fields of a signal's own kind, those that hold a list left out.

    A field that may be nil leaves its cell empty.
    """
    info = inspect.type_info(signal.type)
    assert isinstance(info, inspect.StructType)
    return tuple(
        (field.name, _TYPE_OF[type(not_nil(field.type))])
        for field in info.fields
        if field.name not in HEAD_FIELDS and not isinstance(field.type, inspect.VarTupleType)
    )


class TableFile:
    """A table that is being written."""

    def __init__(self, path: Path, columns: Columns, plan: RunPlan, batch_rows: int) -> None:
        self.rows = 0
        time_and_cycle = (("time", pa.timestamp("ns", tz=plan.timing.timezone)), ("cycle", _INT))
        metadata = {"heliarch.run_id": plan.run_id, "heliarch.plant": plan.plant}
        self._schema = pa.schema([*time_and_cycle, *columns], metadata=metadata)
        self._waiting: list[Row] = []
        self._batch_rows = batch_rows
        self._is_csv = path.suffix == ".csv"
        self._writer: Any
        if self._is_csv:
            self._writer = CSVWriter(path, self._schema.set(0, pa.field("time", _TEXT)))
        else:
            texts = [field.name for field in self._schema if field.type == _TEXT]
            # Names repeat, numbers hardly do: a dictionary of them would cost size and time.
            self._writer = ParquetWriter(
                path, self._schema, compression="zstd", use_dictionary=texts
            )

    def add(self, row: Row) -> None:
        self._waiting.append(row)
        if len(self._waiting) >= self._batch_rows:
            self.flush()

    def flush(self) -> None:
        if not self._waiting:
            return
        columns = zip(*self._waiting, strict=True)
        arrays = [
            pa.array(cells, field.type) for cells, field in zip(columns, self._schema, strict=True)
        ]
        if self._is_csv:
            arrays[0] = _iso_times(arrays[0])
            self._writer.write(pa.table(arrays, names=self._schema.names))
        else:
            self._writer.write(pa.table(arrays, schema=self._schema))
        self.rows += len(self._waiting)
        self._waiting = []

    def close(self) -> None:
        self._writer.close()


def _iso_times(times: pa.Array) -> pa.Array:
    """Return times as local ISO 8601 with the offset from UTC, to the microsecond."""
    encoded = times.dictionary_encode()  # The messages of a cycle all have its time.
    distinct = encoded.dictionary.cast(pa.timestamp("us", tz=times.type.tz), safe=False)
    return pc.strftime(distinct, format="%Y-%m-%dT%H:%M:%S%Ez").take(encoded.indices)


class TableFolder:
    """A folder of tables that is being written.

    `ready_time_ns`, `publish_time_ns` and `log_time_ns` are of the host's monotonic clock: the
    decision took the time between the first two, the way to the recorder that between the last two.
    """

    def __init__(
        self,
        folder: Path,
        plan: RunPlan,
        signals: Sequence[Signal[Message]],
        anchor: ClockAnchor,
        form: TableForm,
        batch_rows: int = BATCH_ROWS,
    ) -> None:
        folder.mkdir()
        self._leaves = plan.tree.leaves
        self._monotonic_less_wall_ns = anchor.monotonic_ns - anchor.wall_ns
        columns = {signal.name: (*_own_columns(signal), *_OF_MESSAGES) for signal in signals}
        self._cells = {
            name: attrgetter(*(column for column, _ in entries[:-1]))
            for name, entries in columns.items()
        }
        tables: dict[str, Columns] = {
            name: (("node", _TEXT), *entries) for name, entries in columns.items()
        }
        tables |= {
            name: tuple((column, _OF_TYPE[kind]) for column, kind in table.columns)
            for name, table in LISTS.items()
            if table.signal is None or table.signal in signals
        }
        self.files = {
            name: TableFile(folder / f"{name}.{form}", entries, plan, batch_rows)
            for name, entries in tables.items()
        }

    def add(self, record: RecordedMessage, message: Message) -> None:
        """Add the rows of a message to the table of its signal, and to those of its lists."""
        signal, files = record.port.signal.name, self.files
        node, when = agent_name(record.port.node), (message.sim_time_ns, message.cycle)
        logged_ns = record.log_time_ns + self._monotonic_less_wall_ns
        files[signal].add((*when, node, *self._cells[signal](message), logged_ns))
        for name, row in list_rows(record.port, message, self._leaves):
            files[name].add((*when, *row))

    def __enter__(self) -> TableFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        for file in self.files.values():
            if kind is None:
                file.flush()
            file.close()
