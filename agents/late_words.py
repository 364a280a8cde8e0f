"""Late words: messages that came after their stage had closed, kept for when a newer one fails.

Of each port the newest is kept, and used once (docs/decisions/0008).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, TypeAlias

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port

LatePolicy: TypeAlias = Literal["use", "drop"]
"""What becomes of messages that come after their stage has closed."""


class LateWords:
    """The newest late word of each port, if it is newer than what was last used of the port."""

    def __init__(self) -> None:
        self._kept: dict[Port[Message], Message] = {}
        self._newest_used: dict[Port[Message], int] = {}

    def __bool__(self) -> bool:
        return bool(self._kept)

    def keep(self, port: Port[Message], message: Message) -> Message | None:
        """Keep a late word if it says more than what was used or is kept.

        Returns
        -------
        Message or None
            The one that is of no use any more: the word itself, or the one that it supersedes.
        """
        kept = self._kept.get(port)
        newest = kept.cycle if kept is not None else self._newest_used.get(port, -1)
        if message.cycle <= newest:
            return message
        self._kept[port] = message
        return kept

    def take(self, port: Port[Message]) -> Message | None:
        """Take the late word of a port to use it, if there is one."""
        message = self._kept.pop(port, None)
        if message is not None:
            self._newest_used[port] = message.cycle
        return message

    def came_in_time(self, port: Port[Message], cycle: int) -> Message | None:
        """Note that a port's message of a cycle is used; return the late word it supersedes."""
        self._newest_used[port] = cycle
        return self._kept.pop(port, None)

    def not_used(self, ports: Iterable[Port[Message]]) -> None:
        """Note that what had come of some ports is not used after all, and may be kept late."""
        for port in ports:
            del self._newest_used[port]

    def any_of(self, ports: frozenset[Port[Message]]) -> frozenset[Port[Message]]:
        """Return those of the ports of which there is a late word."""
        return ports.intersection(self._kept)

    def clear(self) -> tuple[Delivery, ...]:
        """Forget the late words, and return them."""
        kept = tuple(self._kept.items())
        self._kept = {}
        return kept
