"""Compares recorded messages with new ones, and counts the differences of each agent.

Messages are equal bit for bit, or within a tolerance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import msgspec

from bus_schemas.codec import encode
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
        received = msgspec.to_builtins(port.signal.decode(payload))
        known = msgspec.to_builtins(recorded)
        return tuple(
            difference
            for name in recorded.__struct_fields__
            if name not in self.ignored
            for difference in self._differing(name, known.get(name), received.get(name))
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

KINDS: Final = {
    "differs": "differs",
    "only recorded": "recorded, but not sent any more",
    "only new": "sent now, but not recorded",
    "refused": "no listener accepts it",
    "sent twice": "a second message of this cycle, sent by the agent or in its name",
    "not recorded": "the recording lost messages before this one",
    "input not recorded": "used, but not recorded",
    "fails": "raises an error, or sends what cannot be sent",
}
"""How new messages can differ from the recorded ones."""

LOSSES: Final = frozenset({"only new", "not recorded", "input not recorded"})
"""Kinds that only show that the recording lacks messages."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between the recording and what the agent does now.

    `message` is the key of the message that differs, or of the input that is not recorded;
    `content` the recorded message if there is one, else the new one; `inputs` what the agent
    received in that cycle, by key; `text` the error of an agent that fails, or
    why a message is refused.
    """

    kind: str
    cycle: int
    stage: str
    message: str = ""
    fields: tuple[FieldDifference, ...] = ()
    content: Message | None = None
    inputs: dict[str, Message] = field(default_factory=dict)
    text: str = ""


@dataclass(slots=True)
class Gap:
    """Cycles in which an agent cannot be compared, `until` excluded; None: up to the end."""

    since: int
    until: int | None
    why: str


@dataclass(slots=True)
class AgentResult:
    """The result of running one agent again, up to its failure, if it fails.

    It counts messages in the recording, pairs that were compared, and differences by kind.
    """

    recorded: int = 0
    compared: int = 0
    differences: Counter[str] = field(default_factory=Counter)
    first: Difference | None = None
    last_cycle: int = -1
    failure: Difference | None = None
    gaps: list[Gap] = field(default_factory=list)

    def compare(
        self,
        equality: Equality,
        port: Port[Message],
        recorded: Message | None,
        new: Message | None,
        stage: str,
        inputs: Mapping[Port[Message], Message] | None = None,
        refused: str = "",
    ) -> None:
        """Compare a recorded message with the new one. `refused` is why no listener accepts it."""
        message = recorded or new
        if message is None:
            return
        fields: tuple[FieldDifference, ...] = ()
        kind = "only new" if recorded is None else "only recorded"
        if recorded is not None and new is not None:
            fields = equality.differences(port, recorded, new)
            self.compared += 1
            if not fields and not refused:
                return
            kind = "refused" if refused else "differs"
        used = {str(port): message for port, message in (inputs or {}).items()}
        self.add(Difference(kind, message.cycle, stage, str(port), fields, message, used, refused))

    def add(self, difference: Difference) -> None:
        self.differences[difference.kind] += 1
        self.last_cycle = max(self.last_cycle, difference.cycle)
        if difference.kind == "fails":
            self.failure = difference
        if self.first is None or difference.cycle < self.first.cycle:
            self.first = difference
