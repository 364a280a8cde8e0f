"""The bus, as the driver sees it, and what every kind of bus does with a message it sends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol, TypeAlias

from bus_schemas.messages import Message
from bus_schemas.signals import Port

Delivery: TypeAlias = tuple[Port[Message], Message]
"""What an agent publishes."""


class Arrival(NamedTuple):
    """A message that has come to an agent, and when [ns of the run's clock]."""

    agent: str
    port: Port[Message]
    message: Message
    time_ns: int


class Cause(StrEnum):
    """Why a message is not used."""

    DUPLICATE = "duplicate"
    LATE = "late"
    WRONG_SENDER = "wrong_sender"
    OUT_OF_RANGE = "out_of_range"
    WRONG_CYCLE = "wrong_cycle"
    CONFLICTING = "conflicting"
    UNDECODABLE = "undecodable"
    FLOODED = "flooded"
    UNKNOWN = "unknown"


class Bus(Protocol):
    """Takes the messages of one or more agents and brings them those of others."""

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        """Send a message to the listeners of its port."""

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        """Wait for messages, `wanted` being of use, until a time of the run's clock if given."""


class Outbox:
    """Stamps messages with their publish time and number: from 0 for each incarnation."""

    def __init__(self) -> None:
        self._sent: dict[tuple[Port[Message], int], int] = {}

    def stamp(self, port: Port[Message], message: Message, now_ns: int) -> None:
        message.publish_time_ns = now_ns
        if message.cycle >= 0:
            key = (port, message.incarnation)
            message.sequence = sequence = self._sent.get(key, 0)
            self._sent[key] = sequence + 1

    @property
    def published(self) -> Counter[str]:
        """Messages published in the run, by signal: they must be recorded."""
        counts: Counter[str] = Counter()
        for (port, _), sent in self._sent.items():
            if port.signal.logged:
                counts[port.signal.name] += sent
        return counts
