"""Tells whether more than one program speaks on a key.

A publisher says one thing in a cycle, and numbers its messages upwards. A process that replaces it
says so by its incarnation, and the one it replaced is silent from then on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import msgspec

from bus_schemas.codec import decode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.record.message_complaints import REPEATED, TWO_SENDERS

_MOST_KEPT = 4
"""Messages of a key that are kept: one of the cycle under way, and of those beside it."""

_UNDECIDED = ("ready_time_ns", "publish_time_ns", "sequence", "incarnation", "missing")


class _Key:
    """The newest messages of one key, by cycle, and the newest incarnation of its publisher."""

    __slots__ = ("incarnation", "payloads")

    def __init__(self) -> None:
        self.payloads: dict[int, bytes] = {}
        self.incarnation = 0


class SecondSenders:
    """The newest messages of all keys on which each cycle has one message.

    Of agents with a standby two processes may speak, until one has heard the other.
    """

    def __init__(self, ports: Iterable[Port[Message]], standbys: Collection[str] = ()) -> None:
        self._keys = {port: _Key() for port in ports}
        self._standbys = standbys

    def see(
        self, port: Port[Message], cycle: int, incarnation: int, payload: bytes
    ) -> tuple[str, str] | None:
        """Return the cause and text of a complaint, if a message does not go with earlier ones."""
        key = self._keys.get(port)
        if key is None:
            return None
        if incarnation < key.incarnation:
            if cycle <= key.incarnation or port.publisher in self._standbys:  # It was on its way.
                return None
            joined = f"one joined in cycle {key.incarnation}, another in {incarnation}"
            return TWO_SENDERS, f"{joined}, and both sent after that"
        if incarnation > key.incarnation:
            key.incarnation = incarnation
            key.payloads.clear()
        first = key.payloads.setdefault(cycle, payload)
        if first is not payload:
            return _compare(port, first, payload)
        if len(key.payloads) > _MOST_KEPT:
            oldest = min(key.payloads)
            del key.payloads[oldest if oldest != cycle else max(key.payloads)]
        return None


def _compare(port: Port[Message], first: bytes, second: bytes) -> tuple[str, str]:
    """Say in what two messages of one key and cycle differ."""
    try:
        one, other = decode(port.signal, first), decode(port.signal, second)
    except msgspec.DecodeError as error:
        return TWO_SENDERS, f"two messages in one cycle, of which one does not decode: {error}"
    cycle = one.cycle
    for field in one.__struct_fields__:
        values = getattr(one, field), getattr(other, field)
        if field not in _UNDECIDED and repr(values[0]) != repr(values[1]):
            told = " and ".join(str(value)[:60] for value in values)
            return TWO_SENDERS, f"two messages in cycle {cycle}, {field} {told}"
    if first != second and other.sequence <= one.sequence:
        numbers = f"numbers {one.sequence} and {other.sequence}"
        return TWO_SENDERS, f"two messages in cycle {cycle} that do not count up, {numbers}"
    return REPEATED, f"it came again for cycle {cycle}"
