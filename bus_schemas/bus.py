"""The bus, as agents see it, and what every kind of bus does with a message on its way out."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias

from msgspec.structs import replace

from bus_schemas.messages import Message
from bus_schemas.signals import Port

Delivery: TypeAlias = tuple[Port[Message], Message]
"""A message and the port that it is for: what an agent publishes."""


class Arrival(NamedTuple):
    """A message that has come in, its port, and when it came [ns of the monotonic clock]."""

    port: Port[Message]
    message: Message
    time_ns: int


class Bus(Protocol):
    """Takes an agent's messages and brings it those of others."""

    def publish(self, port: Port[Message], message: Message) -> None:
        """Send a message to all who listen to its port."""

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        """Return what has arrived: as soon as `wanted` messages are there, or at the time-out.

        Messages that no listed port takes are dropped, counted and named in the log.
        """


class Outbox:
    """Stamps messages with their publish time and number, and counts those of the run.

    Parameters
    ----------
    clock_ns
        Tells the time that messages go out at [ns].
    """

    def __init__(self, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock_ns = clock_ns
        self._sent: dict[Port[Message], int] = {}

    def stamp(self, port: Port[Message], message: Message) -> Message:
        """Return the message as it goes out."""
        if message.cycle < 0:
            return replace(message, publish_time_ns=self._clock_ns())
        sequence = self._sent.get(port, 0)
        self._sent[port] = sequence + 1
        return replace(message, publish_time_ns=self._clock_ns(), sequence=sequence)

    @property
    def published(self) -> Counter[str]:
        """Messages published in the cycles of the run, by signal name.

        Arming rounds and signals that are not logged are left out: this is what a recording must
        hold.
        """
        counts: Counter[str] = Counter()
        for port, sent in self._sent.items():
            if port.signal.logged:
                counts[port.signal.name] += sent
        return counts
