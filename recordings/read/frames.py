"""The messages of one signal, or the lists in them, as tables."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import nan
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
from msgspec import UNSET, UnsetType, inspect

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from bus_schemas.messages import GivenUp, Message, Production, Setpoint, parse_missing
from bus_schemas.signals import GIVEN_UP, PRODUCTION, SETPOINT, SIGNALS, Port, Signal
from bus_schemas.tree import ControlTree, agent_name

if TYPE_CHECKING:
    import pandas as pd

HEAD_FIELDS: Final = frozenset(Message.__struct_fields__)
"""Fields of every message. The others are a signal's own."""

Cell: TypeAlias = int | float | str | UnsetType | None
Columns: TypeAlias = tuple[tuple[str, type], ...]
"""Names, with the unit in them, and types: `int`, `float`, `str`, or `tuple` for a list."""

_TYPES: Final = {inspect.FloatType: float, inspect.IntType: int, inspect.VarTupleType: tuple}
_SIGNALS: Final = {signal.name: signal for signal in SIGNALS}
_CODES: Final = {float: "d", int: "q"}
_NAMES: Final = frozenset(
    {"node", "inverter", "storage", "donor", "needy", "signal", "input", "agent"}
)
"""Columns of text in which few values repeat."""


class ListTable(NamedTuple):
    """A table: of which signal (None: of all), and its columns."""

    signal: Signal[Message] | None
    columns: Columns


LISTS: Final = {
    "help_given": ListTable(
        SETPOINT, (("donor", str), ("needy", str), ("power_kw", float), ("sequence", int))
    ),
    "production_inverters": ListTable(
        PRODUCTION, (("inverter", str), ("mpp_kw", float), ("power_kw", float), ("sequence", int))
    ),
    "production_storages": ListTable(
        PRODUCTION,
        (("storage", str), ("power_kw", float), ("energy_kwh", float), ("sequence", int)),
    ),
    "given_up_agents": ListTable(GIVEN_UP, (("agent", str), ("sequence", int))),
    # `used_cycle` is that of the older message that the sender used; empty if it used none.
    "missing_inputs": ListTable(
        None,
        (("node", str), ("signal", str), ("sequence", int), ("input", str), ("used_cycle", float)),
    ),
}


def own_columns(signal: Signal[Message]) -> Columns:
    """Return the columns of a signal's own fields; a number that may be nil is a float."""
    info = inspect.type_info(signal.type)
    assert isinstance(info, inspect.StructType)
    own = (field for field in info.fields if field.name not in HEAD_FIELDS)
    return tuple((field.name, _column_type(field.type)) for field in own)


def _column_type(kind: inspect.Type) -> type:
    if isinstance(kind, inspect.UnionType):
        has_list = any(isinstance(one, inspect.VarTupleType) for one in kind.types)
        return tuple if has_list else float
    return _TYPES.get(type(kind), str)


def list_rows(
    port: Port[Message], message: Message, tree: ControlTree
) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    """Yield the rows of the lists in a message, each with the name of its table."""
    node, sequence = agent_name(port.node), message.sequence
    if isinstance(message, Setpoint):
        for line in message.help_given:
            yield "help_given", (node, agent_name(line.needy), line.power_kw, sequence)
    elif isinstance(message, Production):
        mpp_kw, power_kw = message.inverter_mpp_kw, message.inverter_power_kw
        if not len(mpp_kw) == len(power_kw) == len(tree.leaves):
            raise InputError(
                f"production of cycle {message.cycle}: expected {len(tree.leaves)} inverters, got "
                f"{len(mpp_kw)} maxima and {len(power_kw)} powers"
            )
        for row in zip(tree.leaves, mpp_kw, power_kw, strict=True):
            yield "production_inverters", (*row, sequence)
        stored = message.storage_power_kw or (), message.storage_energy_kwh or ()
        for row in zip(tree.storage_paths, *stored, strict=False):
            yield "production_storages", (*row, sequence)
    elif isinstance(message, GivenUp):
        for agent in message.agents:
            yield "given_up_agents", (agent, sequence)
    for entry in message.missing:
        yield "missing_inputs", (node, port.signal.name, sequence, *parse_missing(entry))


def frames(
    plan: RunPlan,
    names: Sequence[str],
    deliveries: Iterable[Delivery],
    on_wrong: Callable[[Port[Message], str], object],
) -> dict[str, pd.DataFrame]:
    """Return tables by name: of signals, a message in each row, or of `LISTS`.

    on_wrong: Called for each message with unreadable lists.
    """
    own = {name: own_columns(_SIGNALS[name]) for name in names if name not in LISTS}
    cells = {name: [attrgetter(field) for field, _ in columns] for name, columns in own.items()}
    tables = {
        name: _Rows(LISTS[name].columns if name in LISTS else (("node", str), *own[name]))
        for name in names
    }
    for port, message in deliveries:
        if (name := port.signal.name) in cells:
            values = (cell(message) for cell in cells[name])
            tables[name].add(message, (agent_name(port.node), *values))
        if len(cells) == len(tables):
            continue
        try:
            listed = list(list_rows(port, message, plan.tree))
        except InputError as error:
            on_wrong(port, str(error))
            continue
        for name, row in listed:
            if name in tables:
                tables[name].add(message, row)
    return {name: table.frame(plan) for name, table in tables.items()}


class _Rows:
    """Rows of a table, in little more memory than the table itself takes."""

    def __init__(self, columns: Columns) -> None:
        self._times, self._cycles = array("q"), array("q")
        self._columns: dict[str, Any] = {
            name: array(_CODES[kind]) if kind in _CODES else [] for name, kind in columns
        }

    def add(self, message: Message, row: Iterable[Cell]) -> None:
        self._times.append(message.sim_time_ns)
        self._cycles.append(message.cycle)
        for column, cell in zip(self._columns.values(), row, strict=True):
            column.append(nan if cell is None or cell is UNSET else cell)

    def frame(self, plan: RunPlan) -> pd.DataFrame:
        import pandas as pd  # noqa: PLC0415 - it loads slowly

        data: dict[str, object] = {"cycle": np.asarray(self._cycles)}
        for name, column in self._columns.items():
            is_number = isinstance(column, array)
            texts = pd.Categorical(column) if name in _NAMES else column
            data[name] = np.asarray(column) if is_number else texts
        utc = pd.DatetimeIndex(np.asarray(self._times).view("M8[ns]"), name="time", tz="UTC")
        return pd.DataFrame(data, index=utc.tz_convert(plan.timing.timezone), copy=False)
