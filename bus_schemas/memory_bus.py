"""The bus inside one process: hands messages from agent to agent, in the order they are sent."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

from bus_schemas.bus import Outbox
from bus_schemas.messages import Message
from bus_schemas.signals import Port, listeners
from bus_schemas.tree import ControlTree


class MemoryBus:
    """All agents' places on the bus in one.

    There is one queue, so the order of all that happens is the same in every run.

    Parameters
    ----------
    tree
        Control tree of the run.
    tap
        Called with every message that is published, as a recorder would hear it.
    """

    def __init__(
        self, tree: ControlTree, tap: Callable[[Port[Message], Message], None] | None = None
    ) -> None:
        self._tree = tree
        self._tap = tap
        self._outbox = Outbox()
        self._queue: deque[tuple[str, Port[Message], Message]] = deque()
        self._routes: dict[Port[Message], tuple[str, ...]] = {}

    @property
    def published(self) -> Counter[str]:
        """Messages published so far, by signal."""
        return self._outbox.published

    def publish(self, port: Port[Message], message: Message) -> None:
        """Queue a message for each agent that listens to its port."""
        stamped = self._outbox.stamp(port, message)
        if self._tap is not None:
            self._tap(port, stamped)
        routes = self._routes.get(port)
        if routes is None:
            routes = self._routes[port] = listeners(port, self._tree)
        for agent in routes:
            self._queue.append((agent, port, stamped))

    def next(self) -> tuple[str, Port[Message], Message] | None:
        """Take the oldest message from the queue: who gets it, its port, itself."""
        return self._queue.popleft() if self._queue else None
