"""Faults of what a device hears: `heliarch conform` puts them into the plan.

Heliarch cannot stop a message inside a device, so they act where an agent sends to one. The plan
states them cycle by cycle, so a recording shows what the device was sent.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from threading import Timer
from typing import Final, Literal, TypeAlias

import msgspec
from msgspec.structs import replace

from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port

Put: TypeAlias = Callable[[bytes], None]

_NUMBERS: Final = {"nan", "inf"}
"""Numbers that JSON cannot say."""

_DAMAGES: Final[dict[str, Callable[[bytes], bytes]]] = {
    "": lambda payload: payload,
    "empty": lambda payload: b"",
    "garbage": lambda payload: b"\xc1",
    "cut": lambda payload: payload[:-1],
    "longer": lambda payload: payload + b"\xc0",
    "list": lambda payload: b"\x93\x01\x02\x03",
    "no cycle": lambda payload: payload.replace(b"\xa5cycle", b"\xa5cycel"),
    "no power": lambda payload: payload.replace(b"\xa8power_kw", b"\xa8power_xx"),
}


Damage: TypeAlias = Literal["", "empty", "garbage", "cut", "longer", "list", "no cycle", "no power"]


class Copy(msgspec.Struct, frozen=True, omit_defaults=True):
    """A message that a device is sent in place of the right one.

    changes: Fields with other values; "nan" and "inf" stand for these numbers.
    at: When it is sent, as a share of its cycle; 0: at once. Above 1 it is held back.
    """

    changes: dict[str, float | int | str] = {}
    damage: Damage = ""
    at: float = 0.0

    def payload(self, message: Message) -> bytes:
        changes = {
            name: float(value) if value in _NUMBERS else value
            for name, value in self.changes.items()
        }
        return _DAMAGES[self.damage](encode(replace(message, **changes)))


class DeviceFault(msgspec.Struct, frozen=True, omit_defaults=True):
    """The copies that a device is sent on a key in a cycle; without one the message is lost."""

    key: str
    cycle: int
    copies: tuple[Copy, ...] = ()


class DeviceFaults:
    """The faults of a run at work."""

    def __init__(self, faults: Iterable[DeviceFault]) -> None:
        self._copies = {(fault.key, fault.cycle): fault.copies for fault in faults}

    def sent(self, port: Port[Message], message: Message) -> list[tuple[float, bytes]]:
        """Return what is sent in place of a message, and when, as a share of its cycle."""
        copies = self._copies.get((str(port), message.cycle))
        if copies is None:
            return [(0.0, encode(message))]
        return [(copy.at, copy.payload(message)) for copy in copies]

    def disturbed(
        self, port: Port[Message], put: Put, cycle_time_ns: Callable[[float], int]
    ) -> Put:
        """Return how messages are put on a device's link; a cycle begins at `cycle_time_ns`."""

        def put_copies(payload: bytes) -> None:
            message = port.signal.decode(payload)
            for at, copy in self.sent(port, message):
                if not at:
                    put(copy)
                    continue
                wait_s = (cycle_time_ns(message.cycle + at) - time.monotonic_ns()) / 1e9
                timer = Timer(max(wait_s, 0.0), put, (copy,))
                timer.daemon = True
                timer.start()

        return put_copies
