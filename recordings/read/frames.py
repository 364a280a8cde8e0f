"""The messages of one signal, or the lists in them, as tables for pandas.

The lists are help given, the inverters of a production, and missing inputs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Production, Setpoint, parse_missing
from bus_schemas.signals import PRODUCTION, SETPOINT, Port, Signal
from bus_schemas.tree import agent_name

if TYPE_CHECKING:
    import pandas as pd

HEAD_FIELDS: Final = frozenset(Message.__struct_fields__)
"""Fields of every message. The others are a signal's own."""

Cell: TypeAlias = int | float | str | None


class ListTable(NamedTuple):
    """A table: of which signal (None: of all), and its columns with their types."""

    signal: Signal[Message] | None
    columns: tuple[tuple[str, type], ...]


LISTS: Final = {
    "help_given": ListTable(
        SETPOINT, (("donor", str), ("needy", str), ("power_kw", float), ("sequence", int))
    ),
    "production_inverters": ListTable(
        PRODUCTION, (("inverter", str), ("mpp_kw", float), ("power_kw", float), ("sequence", int))
    ),
    # `used_cycle` is that of the older message that the sender used; empty if it used none.
    "missing_inputs": ListTable(
        None,
        (("node", str), ("signal", str), ("sequence", int), ("input", str), ("used_cycle", int)),
    ),
}


def list_rows(
    port: Port[Message], message: Message, leaves: Sequence[str]
) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    """Yield the rows of the lists in a message, each with the name of its table."""
    node, sequence = agent_name(port.node), message.sequence
    if isinstance(message, Setpoint):
        for line in message.help_given:
            yield "help_given", (node, agent_name(line.needy), line.power_kw, sequence)
    elif isinstance(message, Production):
        mpp_kw, power_kw = message.inverter_mpp_kw, message.inverter_power_kw
        if not len(mpp_kw) == len(power_kw) == len(leaves):
            raise InputError(
                f"production of cycle {message.cycle}: expected {len(leaves)} inverters, got "
                f"{len(mpp_kw)} maxima and {len(power_kw)} powers"
            )
        for row in zip(leaves, mpp_kw, power_kw, strict=True):
            yield "production_inverters", (*row, sequence)
    for entry in message.missing:
        yield "missing_inputs", (node, port.signal.name, sequence, *parse_missing(entry))


def signal_frame(
    plan: RunPlan, signal: Signal[Message], deliveries: Iterable[Delivery]
) -> pd.DataFrame:
    """Return the messages of a signal, one row each, with its own fields."""
    fields = [name for name in signal.type.__struct_fields__ if name not in HEAD_FIELDS]
    cells = [attrgetter(name) for name in fields]
    rows = (
        (message, (agent_name(port.node), *(cell(message) for cell in cells)))
        for port, message in deliveries
    )
    return _frame(plan, ["node", *fields], rows)


def list_frame(plan: RunPlan, table: str, deliveries: Iterable[Delivery]) -> pd.DataFrame:
    """Return the rows of a table of `LISTS`."""
    rows = (
        (message, row)
        for port, message in deliveries
        for name, row in list_rows(port, message, plan.tree.leaves)
        if name == table
    )
    return _frame(plan, [name for name, _ in LISTS[table].columns], rows)


def _frame(
    plan: RunPlan, columns: list[str], rows: Iterator[tuple[Message, tuple[Cell, ...]]]
) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415 - it loads slowly

    cells = [(message.sim_time_ns, message.cycle, *row) for message, row in rows]
    frame = pd.DataFrame(cells, columns=["time", "cycle", *columns]).set_index("time")
    utc = pd.to_datetime(frame.index, unit="ns", utc=True)
    return frame.set_index(utc.tz_convert(plan.timing.timezone))
