"""Compares a recorded message with a new one: bit for bit, or within a tolerance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import msgspec

from bus_schemas.codec import decode, encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port

Value: TypeAlias = Any
"""A field's value as plain data: numbers, text and lists of them."""

NOT_COMPARED: Final = ("ready_time_ns", "publish_time_ns", "sequence")
"""The driver sets these when it sends a message; the agent does not decide them."""


@dataclass(frozen=True, slots=True)
class FieldDifference:
    """A field in which two messages differ, or one entry of it: `inverter_power_kw[6]`."""

    field: str
    recorded: Value
    new: Value


@dataclass(frozen=True, slots=True)
class Equality:
    """What counts as equal.

    Floats that differ by the tolerance at most are equal; at 0 they must have the same bits.
    """

    tolerance: float = 0.0
    ignored: frozenset[str] = frozenset()

    def differences(
        self, port: Port[Message], recorded: Message, new: Message
    ) -> tuple[FieldDifference, ...]:
        """Return the fields in which the new message of a port differs from the recorded one.

        It is a MsgspecError or a TypeError if no listener would accept the new message.
        """
        new.ready_time_ns = recorded.ready_time_ns
        new.publish_time_ns = recorded.publish_time_ns
        new.sequence = recorded.sequence
        payload = encode(new)
        if payload == encode(recorded):
            return ()
        # Compare what a listener would get: on the wire an int may stand for a float.
        received = decode(port.signal, payload)
        return tuple(
            difference
            for name in recorded.__struct_fields__
            if name not in self.ignored
            for difference in self._differing(
                name,
                msgspec.to_builtins(getattr(recorded, name)),
                msgspec.to_builtins(getattr(received, name)),
            )
        )

    def _differing(self, name: str, old: Value, now: Value) -> Iterator[FieldDifference]:
        """Yield the parts of a value that differ: of two lists of one length, the entries."""
        if isinstance(old, list | tuple) and isinstance(now, list | tuple) and len(old) == len(now):
            for index, pair in enumerate(zip(old, now, strict=True)):
                yield from self._differing(f"{name}[{index}]", *pair)
        elif not self._equal(old, now):
            yield FieldDifference(name, old, now)

    def _equal(self, old: Value, now: Value) -> bool:
        if msgspec.msgpack.encode(old) == msgspec.msgpack.encode(now):  # All bits of a float.
            return True
        are_floats = isinstance(old, float) and isinstance(now, float)
        return are_floats and abs(old - now) <= self.tolerance > 0.0


BIT_FOR_BIT: Final = Equality()
