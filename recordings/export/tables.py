"""A recording as tidy tables in CSV or Parquet: one observation in a row, one value in a cell.

Every signal has a table of its own, named after it. What is a list inside a message has one too:
help given, the inverters of a production, the inputs that were not due. Both formats are written by
pyarrow, a batch of rows at a time, so memory does not grow with the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import pyarrow as pa
import pyarrow.compute as pc
from msgspec import inspect
from pyarrow.csv import CSVWriter
from pyarrow.parquet import ParquetWriter

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Production, Setpoint
from bus_schemas.missing import parse_missing
from bus_schemas.signals import PRODUCTION, SETPOINT, Signal
from bus_schemas.tree import agent_name
from recordings.export.json_messages import not_nil
from recordings.read.reader import RecordedMessage
from recordings.record.writer import ClockAnchor

TableForm: TypeAlias = Literal["csv", "parquet"]
Row: TypeAlias = tuple[int | float | str | None, ...]
Rows: TypeAlias = Callable[[RecordedMessage, Message], Iterable[Row]]

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
_HEAD: Final = frozenset(Message.__struct_fields__)


@dataclass(frozen=True, slots=True)
class Table:
    """A tidy table, named like its file.

    The names of columns have the unit in them; `time` [ns since 1970-01-01 UTC] and `cycle` come
    first in every table. `rows` gives the rows of this table that a message adds, none or more.
    """

    name: str
    columns: tuple[tuple[str, pa.DataType], ...]
    rows: Rows

    def schema(self, plan: RunPlan) -> pa.Schema:
        """Return the types of all columns, with the names of the run."""
        columns = [("time", pa.timestamp("ns", tz=plan.timezone)), ("cycle", _INT), *self.columns]
        metadata = {"heliarch.run_id": plan.run_id, "heliarch.plant": plan.plant}
        return pa.schema(columns, metadata=metadata)


def tables_of(
    signals: Sequence[Signal[Message]], plan: RunPlan, anchor: ClockAnchor
) -> dict[Signal[Message], tuple[Table, ...]]:
    """Return by signal the tables that its messages have rows in; the last is common to all."""
    missing = missing_inputs_table()
    details = {SETPOINT: (help_given_table(),), PRODUCTION: (inverters_table(plan),)}
    return {
        signal: (signal_table(signal, anchor), *details.get(signal, ()), missing)
        for signal in signals
    }


def signal_table(signal: Signal[Message], anchor: ClockAnchor) -> Table:
    """Return the table of a signal: a row for each message, a column for each plain field.

    `ready_time_ns`, `publish_time_ns` and `log_time_ns` are of the host's monotonic clock: the
    decision took the time between the first two, the way to the recorder that between the last two.
    """
    own = _own_columns(signal)
    when = attrgetter("sim_time_ns", "cycle")
    head = ("source", "sequence", "incarnation", "ready_time_ns", "publish_time_ns")
    rest = attrgetter(*(name for name, _ in own), *head)
    monotonic_less_wall_ns = anchor.monotonic_ns - anchor.wall_ns

    def rows(record: RecordedMessage, message: Message) -> Iterable[Row]:
        logged_ns = record.log_time_ns + monotonic_less_wall_ns
        return ((*when(message), agent_name(record.port.node), *rest(message), logged_ns),)

    numbers = [(name, _INT) for name in (*head[1:], "log_time_ns")]
    return Table(signal.name, (("node", _TEXT), *own, ("source", _TEXT), *numbers), rows)


def help_given_table() -> Table:
    """Return the table of help: a row for each entry of the setpoint of a donor."""

    def rows(record: RecordedMessage, message: Message) -> Iterable[Row]:
        assert isinstance(message, Setpoint)
        when = (message.sim_time_ns, message.cycle, agent_name(record.port.node))
        return (
            (*when, agent_name(line.needy), line.power_kw, message.sequence)
            for line in message.help_given
        )

    columns = (("donor", _TEXT), ("needy", _TEXT), ("power_kw", _NUMBER), ("sequence", _INT))
    return Table("help_given", columns, rows)


def inverters_table(plan: RunPlan) -> Table:
    """Return the table of what each inverter could produce and did: a row for each, each cycle."""
    leaves = plan.tree.leaves

    def rows(_: RecordedMessage, message: Message) -> Iterable[Row]:
        assert isinstance(message, Production)
        mpp_kw, power_kw = message.inverter_mpp_kw, message.inverter_power_kw
        if not len(mpp_kw) == len(power_kw) == len(leaves):
            raise InputError(
                f"production of cycle {message.cycle}: expected {len(leaves)} inverters, got "
                f"{len(mpp_kw)} maxima and {len(power_kw)} powers"
            )
        when = (message.sim_time_ns, message.cycle)
        powers = zip(leaves, mpp_kw, power_kw, strict=True)
        return ((*when, *power, message.sequence) for power in powers)

    powers = (("mpp_kw", _NUMBER), ("power_kw", _NUMBER))
    columns = (("inverter", _TEXT), *powers, ("sequence", _INT))
    return Table("production_inverters", columns, rows)


def missing_inputs_table() -> Table:
    """Return the table of inputs that were not due: a row for each of each message.

    `used_cycle` is the cycle of the older message that the sender used; empty if it used none.
    """

    def rows(record: RecordedMessage, message: Message) -> Iterable[Row]:
        if not message.missing:
            return ()
        port = record.port
        when = (message.sim_time_ns, message.cycle)
        which = (agent_name(port.node), port.signal.name, message.sequence)
        return ((*when, *which, *parse_missing(entry)) for entry in message.missing)

    which = (("node", _TEXT), ("signal", _TEXT), ("sequence", _INT))
    return Table("missing_inputs", (*which, ("input", _TEXT), ("used_cycle", _INT)), rows)


def _own_columns(signal: Signal[Message]) -> tuple[tuple[str, pa.DataType], ...]:
    """Columns for the fields of a signal's own kind, those that hold a list left out.

    A field that may be nil leaves its cell empty.
    """
    found = inspect.type_info(signal.type)
    assert isinstance(found, inspect.StructType)
    return tuple(
        (field.name, _TYPE_OF[type(not_nil(field.type))])
        for field in found.fields
        if field.name not in _HEAD and not isinstance(field.type, inspect.VarTupleType)
    )


class TableFile:
    """A table that is being written."""

    def __init__(
        self, path: Path, table: Table, form: TableForm, plan: RunPlan, batch_rows: int
    ) -> None:
        self.path = path.with_name(f"{path.name}.{form}")
        self.rows = 0
        self._schema = table.schema(plan)
        self._waiting: list[Row] = []
        self._batch_rows = batch_rows
        self._is_csv = form == "csv"
        self._writer: Any
        if self._is_csv:
            self._time_unit = _time_unit(plan)
            self._writer = CSVWriter(self.path, self._schema.set(0, pa.field("time", _TEXT)))
        else:
            texts = [field.name for field in self._schema if field.type == _TEXT]
            # Names repeat, numbers hardly do: a dictionary of them would cost size and time.
            self._writer = ParquetWriter(
                self.path, self._schema, compression="zstd", use_dictionary=texts
            )

    def add(self, rows: Iterable[Row]) -> None:
        self._waiting.extend(rows)
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
            arrays[0] = _iso_times(arrays[0], self._time_unit)
            self._writer.write(pa.table(arrays, names=self._schema.names))
        else:
            self._writer.write(pa.table(arrays, schema=self._schema))
        self.rows += len(self._waiting)
        self._waiting = []

    def close(self) -> None:
        self._writer.close()


def _time_unit(plan: RunPlan) -> str:
    """Return the coarsest unit that gives the beginning of every cycle exactly."""
    units = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
    times_ns = (plan.start_time_ns, plan.cycle_ns)
    return next(unit for unit, ns in units.items() if not any(time % ns for time in times_ns))


def _iso_times(times: pa.Array, unit: str) -> pa.Array:
    """Return times as local ISO 8601 with the offset from UTC."""
    encoded = times.dictionary_encode()  # The messages of a cycle all have its time.
    distinct = encoded.dictionary
    with suppress(pa.ArrowInvalid):  # A time between the cycles keeps all its digits.
        distinct = distinct.cast(pa.timestamp(unit, tz=times.type.tz))
    return pc.strftime(distinct, format="%Y-%m-%dT%H:%M:%S%Ez").take(encoded.indices)


class TableFolder:
    """A folder of tables that is being written."""

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
        self._tables = tables_of(signals, plan, anchor)
        every = {table.name: table for tables in self._tables.values() for table in tables}
        # Tables of signals first, the one that they share at the end.
        names = [name for name in every if name != "missing_inputs"] + ["missing_inputs"]
        self.files = {
            name: TableFile(folder / name, every[name], form, plan, batch_rows) for name in names
        }

    def add(self, record: RecordedMessage, message: Message) -> None:
        for table in self._tables[record.port.signal]:
            self.files[table.name].add(table.rows(record, message))

    def __enter__(self) -> TableFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        for file in self.files.values():
            if kind is None:
                file.flush()
            file.close()
