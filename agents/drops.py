"""Messages that an agent received and did not use: how many, why, and on which ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bus_schemas.messages import Message
from bus_schemas.signals import Port

Cause: TypeAlias = Literal["late", "other_cycle", "unexpected", "duplicate", "foreign"]


@dataclass
class Drops:
    """How many messages were dropped, by cause."""

    late: int = 0
    other_cycle: int = 0
    unexpected: int = 0
    duplicate: int = 0
    foreign: int = 0

    def total(self) -> int:
        """All of them."""
        return sum(vars(self).values())


class DropAccount:
    """The account of one agent's drops.

    Parameters
    ----------
    on_drop
        Called with a line of text for each of them.

    Attributes
    ----------
    drops, of_ports
        How many there were: by cause, and by port and cause.
    """

    def __init__(self, on_drop: Callable[[str], None]) -> None:
        self.drops = Drops()
        self.of_ports: dict[str, dict[str, int]] = {}
        self._on_drop = on_drop

    def add(self, cause: Cause, port: Port[Message], text: str) -> None:
        """Count a message that was dropped, and say why."""
        setattr(self.drops, cause, getattr(self.drops, cause) + 1)
        causes = self.of_ports.setdefault(str(port), {})
        causes[cause] = causes.get(cause, 0) + 1
        self._on_drop(text)
