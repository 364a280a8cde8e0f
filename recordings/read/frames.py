"""Messages as a pandas table."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import pandas as pd
from msgspec.structs import fields

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from bus_schemas.tree import agent_name

_HEAD: Final = frozenset(field.name for field in fields(Message))


def message_frame(
    signal: Signal[Message], deliveries: Iterable[Delivery], timezone: str
) -> pd.DataFrame:
    """Return messages of one signal as a table, one row each."""
    own = [field.name for field in fields(signal.type) if field.name not in _HEAD]
    times: list[int] = []
    columns: dict[str, list[Any]] = {name: [] for name in ("cycle", "node", *own)}
    for port, message in deliveries:
        times.append(message.sim_time_ns)
        columns["cycle"].append(message.cycle)
        columns["node"].append(agent_name(port.node))
        for name in own:
            columns[name].append(getattr(message, name))
    index = pd.to_datetime(pd.Series(times, dtype="int64"), unit="ns", utc=True)
    return pd.DataFrame(columns, index=pd.DatetimeIndex(index, name="time").tz_convert(timezone))
