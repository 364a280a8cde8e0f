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
from msgspec import UNSET
from pyarrow.csv import CSVWriter
from pyarrow.parquet import ParquetWriter

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from bus_schemas.tree import agent_name
from recordings.read.frames import LISTS, Cell, Columns, list_rows, own_columns
from recordings.read.reader import RecordedMessage
from recordings.record.writer import ClockAnchor

TableForm: TypeAlias = Literal["csv", "parquet"]

BATCH_ROWS: Final = 65_536
"""Rows that are written at once: a row group of some megabytes in Parquet."""

_TYPES: Final = {int: pa.int64(), float: pa.float64(), str: pa.string()}
_OF_MESSAGES: Final[Columns] = (
    *(("source", str), ("sequence", int), ("incarnation", int)),
    *(("ready_time_ns", int), ("publish_time_ns", int), ("log_time_ns", int)),
)
"""Last columns of the table of every signal."""


class TableFile:
    """A table that is being written; every one begins with the time and the number of a cycle."""

    def __init__(self, path: Path, columns: Columns, plan: RunPlan, batch_rows: int) -> None:
        self.rows = 0
        self._time = pa.timestamp("ns", tz=plan.timing.timezone)
        self._is_csv = path.suffix == ".csv"
        self._batch_rows = batch_rows
        self._waiting: list[tuple[Cell, ...]] = []
        named = (("cycle", int), *columns)
        fields = [pa.field("time", pa.string() if self._is_csv else self._time)]
        fields += [pa.field(name, _TYPES[kind]) for name, kind in named]
        origin = {"heliarch.run_id": plan.run_id, "heliarch.plant": plan.plant}
        self._schema = pa.schema(fields, metadata=origin)
        self._writer: Any
        if self._is_csv:
            self._writer = CSVWriter(path, self._schema)
        else:
            # Names repeat, numbers hardly do: a dictionary of them would cost size and time.
            texts = [name for name, kind in named if kind is str]
            self._writer = ParquetWriter(
                path, self._schema, compression="zstd", use_dictionary=texts
            )

    def add(self, row: tuple[Cell, ...]) -> None:
        self._waiting.append(row)
        if len(self._waiting) >= self._batch_rows:
            self.flush()

    def flush(self) -> None:
        if not self._waiting:
            return
        times, *columns = zip(*self._waiting, strict=True)
        first = pa.array(times, self._time)
        arrays = [_iso_times(first) if self._is_csv else first]
        kinds = self._schema.types[1:]
        arrays += [pa.array(cells, kind) for cells, kind in zip(columns, kinds, strict=True)]
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
        self._tree = plan.tree
        self._monotonic_less_wall_ns = anchor.monotonic_ns - anchor.wall_ns
        tables: dict[str, Columns] = {}
        self._cells = {}
        for signal in signals:
            own = tuple(column for column in own_columns(signal) if column[1] is not tuple)
            tables[signal.name] = (("node", str), *own, *_OF_MESSAGES)
            self._cells[signal.name] = attrgetter(*(name for name, _ in (*own, *_OF_MESSAGES[:-1])))
        for name, table in LISTS.items():
            if table.signal is None or table.signal in signals:
                tables[name] = table.columns
        self.files = {
            name: TableFile(folder / f"{name}.{form}", columns, plan, batch_rows)
            for name, columns in tables.items()
        }

    @property
    def rows(self) -> dict[str, int]:
        return {name: file.rows for name, file in self.files.items()}

    def add(self, record: RecordedMessage, message: Message) -> None:
        name, files = record.port.signal.name, self.files
        node, when = agent_name(record.port.node), (message.sim_time_ns, message.cycle)
        logged_ns = record.log_time_ns + self._monotonic_less_wall_ns
        rows = list(list_rows(record.port, message, self._tree))
        cells = (None if cell is UNSET else cell for cell in self._cells[name](message))
        files[name].add((*when, node, *cells, logged_ns))
        for table, row in rows:
            files[table].add((*when, *row))

    def __enter__(self) -> TableFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        for file in self.files.values():
            if kind is None:
                file.flush()
            file.close()
