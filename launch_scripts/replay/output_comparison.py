"""Holds what live agents say against what they said: pairs of messages of one key and cycle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any, Final, Literal, TypeAlias

import msgspec
from msgspec.structs import replace

from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.verification.comparison import Comparison

Kind: TypeAlias = Literal["differs", "other inputs", "only recorded", "only new"]
"""`differs`: in a field. `other inputs`: a deadline fell otherwise, so that the agent had to do
without other inputs; then nothing else of the message can be compared. `only recorded`, `only
new`: the message has no counterpart."""

_MOST_KEPT: Final = 1000
"""So many differences are kept one by one, the rest is counted."""


class OutputDifference(msgspec.Struct, frozen=True):
    """A field in which a live agent's message differs, or a message without its counterpart.

    Attributes
    ----------
    agent
        Who said it.
    cycle, key
        What it is, the key without namespace and plant: `c1/inv07/impp`.
    kind
        In what it differs.
    field
        The field, empty for a message without a counterpart.
    recorded, new
        Its values, None for a message without a counterpart.
    """

    agent: str
    cycle: int
    key: str
    kind: Kind
    field: str = ""
    recorded: Any = None
    new: Any = None


class OutputComparison:
    """Compares messages bit for bit, publish time and sequence left out.

    Attributes
    ----------
    compared
        Pairs of messages that were held against each other.
    differing
        Messages that differ, or lack their counterpart, by agent.
    differences
        The first of them, in their order.
    """

    def __init__(self) -> None:
        self.compared = 0
        self.differing: Counter[str] = Counter()
        self.differences: list[OutputDifference] = []
        self._comparison = Comparison()
        self._recorded: dict[tuple[Port[Message], int], Message] = {}
        self._new: dict[tuple[Port[Message], int], Message] = {}

    def take_recorded(self, port: Port[Message], message: Message) -> None:
        """Take in what an agent said."""
        self._match(port, message, self._recorded)

    def take_new(self, port: Port[Message], message: Message) -> None:
        """Take in what it says now."""
        self._match(port, message, self._new)

    def conclude(self, before_cycle: int) -> None:
        """Count what has no counterpart in the cycles before one."""
        self._keep_single(self._recorded, before_cycle, "only recorded")
        self._keep_single(self._new, before_cycle, "only new")
        self.differences.sort(key=lambda difference: difference.cycle)

    def _keep_single(
        self, messages: Iterable[tuple[Port[Message], int]], before_cycle: int, kind: Kind
    ) -> None:
        for port, cycle in sorted(messages, key=lambda place: (place[1], str(place[0]))):
            if cycle < before_cycle:
                self.differing[port.publisher] += 1
                self._keep(OutputDifference(port.publisher, cycle, str(port), kind))

    def _match(
        self,
        port: Port[Message],
        message: Message,
        own: dict[tuple[Port[Message], int], Message],
    ) -> None:
        if not port.signal.decided:
            return  # What a process counts of itself depends on the machine.
        place = (port, message.cycle)
        other = self._new if own is self._recorded else self._recorded
        counterpart = other.pop(place, None)
        if counterpart is None:
            own[place] = message
        elif own is self._recorded:
            self._compare(port, message, counterpart)
        else:
            self._compare(port, counterpart, message)

    def _compare(self, port: Port[Message], recorded: Message, new: Message) -> None:
        self.compared += 1
        unstamped = replace(new, publish_time_ns=0, sequence=0)
        found = self._comparison.differences(port, recorded, unstamped)
        if not found:
            return
        self.differing[port.publisher] += 1
        place = (port.publisher, recorded.cycle, str(port))
        if recorded.missing != new.missing:
            self._keep(
                OutputDifference(*place, "other inputs", "missing", recorded.missing, new.missing)
            )
            return
        for entry in found:
            self._keep(OutputDifference(*place, "differs", entry.field, entry.recorded, entry.new))

    def _keep(self, difference: OutputDifference) -> None:
        if len(self.differences) < _MOST_KEPT:
            self.differences.append(difference)
