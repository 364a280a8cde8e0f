"""Compares a recorded message with a new one: bit for bit, or within a tolerance."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import msgspec

from bus_schemas.codec import decode, encode
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port

Value: TypeAlias = Any
"""A field's value as plain data: numbers, text and lists of them."""

NOT_COMPARED: Final = ("ready_time_ns", "publish_time_ns", "sequence")
"""The driver fills these in as it sends: the agent does not decide them."""

COMPARED_FIELDS: Final = tuple(
    sorted(
        {
            name
            for signal in SIGNALS
            if signal.logged and signal.decided
            for name in signal.type.__struct_fields__
            if name not in NOT_COMPARED
        }
    )
)
"""Names of all fields that are compared."""


class Unsendable(Exception):  # noqa: N818 - the message is to blame, not the program
    """A new message that cannot be encoded, or that no listener would accept."""


@dataclass(frozen=True, slots=True)
class FieldDifference:
    """A field in which two messages differ, or one entry of it: `inverter_power_kw[6]`."""

    field: str
    recorded: Value
    new: Value


@dataclass(frozen=True, slots=True)
class Comparison:
    """What counts as equal.

    Attributes
    ----------
    tolerance
        Absolute difference of two floats up to which they are equal. At 0 they must be the same
        bits.
    ignored
        Fields that are not compared.
    """

    tolerance: float = 0.0
    ignored: frozenset[str] = frozenset()

    def are_equal(self, recorded: Message, new: Message) -> bool:
        """Whether a new message is the recorded one, bit for bit.

        Raises
        ------
        Unsendable
            The new message cannot be encoded.
        """
        new.ready_time_ns = recorded.ready_time_ns
        new.publish_time_ns = recorded.publish_time_ns
        new.sequence = recorded.sequence
        try:
            return encode(new) == encode(recorded)
        except Exception as error:
            raise Unsendable(f"{type(error).__name__}: {error}") from error

    def differences(
        self, port: Port[Message], recorded: Message, new: Message
    ) -> tuple[FieldDifference, ...]:
        """Return the fields in which the new message of a port differs from the recorded one.

        Raises
        ------
        Unsendable
            The new message could not be sent.
        """
        if self.are_equal(recorded, new):
            return ()
        try:
            # As whoever listens would get it: on the wire an int may stand for a float.
            received = decode(port.signal, encode(new))
        except msgspec.DecodeError as error:
            raise Unsendable(f"{type(error).__name__}: {error}") from error
        return tuple(self._differing_fields(recorded, received))

    def _differing_fields(self, recorded: Message, new: Message) -> Iterator[FieldDifference]:
        left_out = self.ignored.union(NOT_COMPARED)
        for name in recorded.__struct_fields__:
            if name not in left_out:
                old = msgspec.to_builtins(getattr(recorded, name))
                now = msgspec.to_builtins(getattr(new, name))
                yield from self._differing(name, old, now)

    def _differing(self, name: str, old: Value, now: Value) -> Iterator[FieldDifference]:
        """Yield the parts of a value that differ: of lists of one length the entries."""
        if isinstance(old, list | tuple) and isinstance(now, list | tuple) and len(old) == len(now):
            for place, pair in enumerate(zip(old, now, strict=True)):
                yield from self._differing(f"{name}[{place}]", *pair)
        elif not self._equal(old, now):
            yield FieldDifference(name, old, now)

    def _equal(self, old: Value, now: Value) -> bool:
        if isinstance(old, float) and isinstance(now, float):
            return _bits(old) == _bits(now) or abs(old - now) <= self.tolerance > 0.0
        return bool(old == now)


def _bits(value: float) -> bytes:
    return struct.pack("<d", value)
