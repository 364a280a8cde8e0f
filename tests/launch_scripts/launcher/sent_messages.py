"""All that is sent in a run in memory."""

from __future__ import annotations

from typing import Any

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port


class Sent:
    """All messages that were sent in a run, in their order."""

    def __init__(self) -> None:
        self.messages: list[Delivery] = []

    def __call__(self, port: Port[Message], message: Message) -> None:
        self.messages.append((port, message))

    def of(self, port: Port[Message]) -> dict[int, Any]:
        """Each cycle's message of a port."""
        return {message.cycle: message for sent_on, message in self.messages if sent_on is port}
