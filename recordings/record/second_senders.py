"""Tells whether more than one program speaks on a key.

A publisher sends one message in a cycle, and numbers its messages upwards. A process that replaces
it has a higher incarnation, and the replaced one publishes nothing more. Only in lockstep may it be
replaced in the cycle in which it joined: then the next process has the same incarnation, and sends
the same messages once more.
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


class SecondSenders:
    """The newest messages, by cycle, and the newest incarnations of keys with one in each cycle.

    `standbys`: agents of which two processes may speak, until one has heard the other.
    """

    def __init__(self, ports: Iterable[Port[Message]], standbys: Collection[str] = ()) -> None:
        self._payloads: dict[Port[Message], dict[int, bytes]] = {port: {} for port in ports}
        self._newest = dict.fromkeys(self._payloads, 0)
        self._standbys = standbys

    def see(
        self, port: Port[Message], cycle: int, incarnation: int, payload: bytes
    ) -> tuple[str, str] | None:
        """Return the cause and text of a complaint, if a message does not go with earlier ones."""
        payloads = self._payloads.get(port)
        if payloads is None:
            return None
        newest = self._newest[port]
        if incarnation < newest:
            if cycle <= newest or port.publisher in self._standbys:  # It was on its way.
                return None
            joined = f"one joined in cycle {newest}, another in {incarnation}"
            return TWO_SENDERS, f"{joined}, and both sent after that"
        if incarnation > newest:
            self._newest[port] = incarnation
            payloads.clear()
        first = payloads.setdefault(cycle, payload)
        if first is not payload:
            return _compare(port, first, payload)
        if len(payloads) > _MOST_KEPT:
            oldest = min(payloads)
            del payloads[oldest if oldest != cycle else max(payloads)]
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
    has_just_joined = 0 < cycle == one.incarnation
    if first != second and other.sequence <= one.sequence and not has_just_joined:
        numbers = f"numbers {one.sequence} and {other.sequence}"
        return TWO_SENDERS, f"two messages in cycle {cycle} that do not count up, {numbers}"
    return REPEATED, f"it came again for cycle {cycle}"
