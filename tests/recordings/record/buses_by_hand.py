"""A bus and a launcher for a recorder in the test's own process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from agents.process.events import Event
from bus_schemas.messages import Message
from bus_schemas.signals import Port


@dataclass
class SubscriberByHand:
    """Gives a recorder what `drain` yields at the moment; nobody comes or goes."""

    drain: Callable[[], Iterable[tuple[str, bytes]]]

    def watch_tokens(self) -> SubscriberByHand:
        return self

    def changes(self) -> Iterator[tuple[str, bool]]:
        return iter(())

    def publish(self, port: Port[Message], message: Message) -> None:
        """Nobody hears it."""


@dataclass
class LinkByHand:
    """Keeps what a recorder tells its launcher, which wants it to end once it is `dismissed`.

    expected: How many messages the launcher says have been published.
    """

    dismissed: bool = False
    expected: int | None = None
    starts: int = 0
    told: list[Event] = field(default_factory=list)

    def tell(self, event: Event) -> None:
        self.told.append(event)

    def beat(self, cycle: int) -> None:
        """Nobody looks."""

    def expected_messages(self) -> int | None:
        return self.expected
