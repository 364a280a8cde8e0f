"""Which tidy tables a recording comes to: one row for each observation, one value in each cell.

Every signal has a table of its own, named after it. What is a list inside a message has one as
well: help given, the inverters of a production, the inputs that were not due.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, Literal, TypeAlias

from msgspec.inspect import (
    FloatType,
    IntType,
    LiteralType,
    NoneType,
    StrType,
    StructType,
    Type,
    UnionType,
    VarTupleType,
    type_info,
)

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Production, Setpoint
from bus_schemas.missing import parse_missing
from bus_schemas.signals import PRODUCTION, SETPOINT, Signal
from bus_schemas.tree import agent_name
from recordings.export.records import Record
from recordings.record.writer import ClockAnchor

Cell: TypeAlias = int | float | str | None
Row: TypeAlias = tuple[Cell, ...]
Kind: TypeAlias = Literal["time", "integer", "number", "text"]
"""What is in a column. A time is ns since 1970-01-01 UTC here, each format has its own form."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table, with the unit in its name."""

    name: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Table:
    """A tidy table.

    Attributes
    ----------
    name
        Also that of its file.
    columns
        From left to right.
    rows
        Gives the rows of this table that a record comes to, none or more.
    """

    name: str
    columns: tuple[Column, ...]
    rows: Callable[[Record], Iterable[Row]]


_WHEN: Final = (Column("time", "time"), Column("cycle", "integer"))
_SEQUENCE: Final = Column("sequence", "integer")
_READY: Final = Column("ready_time_ns", "integer")
_PUBLISHED: Final = Column("publish_time_ns", "integer")
_LOGGED: Final = Column("log_time_ns", "integer")

_HEAD: Final = frozenset(Message.__struct_fields__)

_KIND_OF: Final[dict[type[Type], Kind]] = {
    FloatType: "number",
    IntType: "integer",
    StrType: "text",
    LiteralType: "text",
}


def tables_of(
    signals: Sequence[Signal[Message]], plan: RunPlan, anchor: ClockAnchor
) -> dict[Signal[Message], tuple[Table, ...]]:
    """Return the tables of some signals.

    Parameters
    ----------
    signals
        Those that are wanted.
    plan
        Of the run.
    anchor
        Of the recording's clocks.

    Returns
    -------
    dict
        By signal: the tables that its messages have rows in. The last one is the same for all.
    """
    missing = missing_inputs_table()
    details = {SETPOINT: (help_given_table(),), PRODUCTION: (inverters_table(plan),)}
    return {
        signal: (signal_table(signal, anchor), *details.get(signal, ()), missing)
        for signal in signals
    }


def signal_table(signal: Signal[Message], anchor: ClockAnchor) -> Table:
    """Return the table of a signal: a row for each message, a column for each plain field.

    `ready_time_ns`, `publish_time_ns` and `log_time_ns` are of the host's monotonic clock. The
    decision took the time between the first two, the way to the recorder that between the last two.
    """
    own = _own_columns(signal)
    names = [column.name for column in own]
    when = attrgetter("sim_time_ns", "cycle")
    rest = attrgetter(*names, "source", "sequence", "ready_time_ns", "publish_time_ns")
    monotonic_less_wall_ns = anchor.monotonic_ns - anchor.wall_ns

    def rows(record: Record) -> Iterable[Row]:
        message = record.message
        return (
            (
                *when(message),
                agent_name(record.port.node),
                *rest(message),
                record.log_time_ns + monotonic_less_wall_ns,
            ),
        )

    columns = (
        *_WHEN,
        Column("node", "text"),
        *own,
        Column("source", "text"),
        _SEQUENCE,
        _READY,
        _PUBLISHED,
        _LOGGED,
    )
    return Table(signal.name, columns, rows)


def help_given_table() -> Table:
    """Return the table of help: a row for each line of a setpoint's account.

    A setpoint is that of the donor; its number is `sequence`.
    """

    def rows(record: Record) -> Iterable[Row]:
        setpoint = record.message
        assert isinstance(setpoint, Setpoint)
        when = (setpoint.sim_time_ns, setpoint.cycle, agent_name(record.port.node))
        return (
            (*when, agent_name(line.needy), line.power_kw, setpoint.sequence)
            for line in setpoint.help_given
        )

    columns = (
        *_WHEN,
        Column("donor", "text"),
        Column("needy", "text"),
        Column("power_kw", "number"),
        _SEQUENCE,
    )
    return Table("help_given", columns, rows)


def inverters_table(plan: RunPlan) -> Table:
    """Return the table of what each inverter could and did produce: a row for each, each cycle."""
    leaves = plan.tree.leaves

    def rows(record: Record) -> Iterable[Row]:
        production = record.message
        assert isinstance(production, Production)
        mpp_kw, power_kw = production.inverter_mpp_kw, production.inverter_power_kw
        if not len(mpp_kw) == len(power_kw) == len(leaves):
            raise InputError(
                f"production of cycle {production.cycle} lists {len(mpp_kw)} maxima and "
                f"{len(power_kw)} powers, accepted is one for each of {len(leaves)} inverters"
            )
        when = (production.sim_time_ns, production.cycle)
        powers = zip(leaves, mpp_kw, power_kw, strict=True)
        return ((*when, *power, production.sequence) for power in powers)

    columns = (
        *_WHEN,
        Column("inverter", "text"),
        Column("mpp_kw", "number"),
        Column("power_kw", "number"),
        _SEQUENCE,
    )
    return Table("production_inverters", columns, rows)


def missing_inputs_table() -> Table:
    """Return the table of inputs that were not due: a row for each of each message.

    `used_cycle` is the cycle of the older message that the sender used; empty if it used none.
    """

    def rows(record: Record) -> Iterable[Row]:
        message = record.message
        if not message.missing:
            return ()
        says = (agent_name(record.port.node), record.port.signal.name, message.sequence)
        when = (message.sim_time_ns, message.cycle)
        return ((*when, *says, *parse_missing(entry)) for entry in message.missing)

    columns = (
        *_WHEN,
        Column("node", "text"),
        Column("signal", "text"),
        _SEQUENCE,
        Column("input", "text"),
        Column("used_cycle", "integer"),
    )
    return Table("missing_inputs", columns, rows)


def _own_columns(signal: Signal[Message]) -> tuple[Column, ...]:
    """Columns for the fields of a signal's own kind, those that hold a list left out."""
    found = type_info(signal.type)
    assert isinstance(found, StructType)
    return tuple(
        Column(field.name, _kind(field.type))
        for field in found.fields
        if field.name not in _HEAD and not isinstance(field.type, VarTupleType)
    )


def _kind(field: Type) -> Kind:
    """Return what is in a field's column; a field that may be nil leaves its cell empty."""
    if isinstance(field, UnionType):
        (field,) = (member for member in field.types if not isinstance(member, NoneType))
    return _KIND_OF[type(field)]
