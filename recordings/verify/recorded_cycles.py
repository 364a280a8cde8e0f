"""Walks through a recording cycle by cycle, with a bounded number of messages in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER, ControlTree

MOST_HELD: Final = 200_000
"""Messages that are held at most for the sake of an agent that lags behind: some 100 MB."""

_MARGIN: Final = 1
"""Cycles by which messages of one agent may overtake each other on their way to the recorder."""


@dataclass(slots=True)
class RecordedCycle:
    """What a recording holds of one cycle.

    Attributes
    ----------
    number
        Number of the cycle.
    messages
        The message of each port; of a port with several the first one.
    repeated
        The further ones.
    """

    number: int
    messages: dict[Port[Message], Message] = field(default_factory=dict)
    repeated: list[Delivery] = field(default_factory=list)


class CycleWalk:
    """The cycles of a recording in their order, each once it is complete.

    Messages of a cycle lie near each other in the file, mixed with those of the next ones: an agent
    may be ahead of another, or be heard late. A cycle is complete once every agent has gone on.

    Parameters
    ----------
    deliveries
        The messages in the order of the file.
    tree, cycles
        Control tree and number of cycles of the run.
    external
        External agents: they may send anything of any cycle.
    most_held
        When so many messages wait for an agent that lags behind or is dead, it is waited for no
        longer.

    Attributes
    ----------
    read
        Messages so far.
    not_decided
        Those of them that no agent decides: the beginning and end of the run.
    newest
        Cycle of the newest message of each agent, -1 if there is none.
    ended
        Whether the whole recording has been read.
    strays
        Messages that belong to no cycle of the run.
    too_late
        Messages, by agent, that lie behind the end of their cycle. External agents may send such.
    """

    def __init__(
        self,
        deliveries: Iterable[Delivery],
        tree: ControlTree,
        cycles: int,
        external: Collection[str] = (),
        most_held: int = MOST_HELD,
    ) -> None:
        self.read = 0
        self.not_decided = 0
        self.newest = {agent: -1 for agent in tree.agents() if agent != RECORDER}
        self.ended = False
        self.strays = 0
        self.too_late: Counter[str] = Counter()
        self._deliveries = deliveries
        self._cycles = cycles
        self._external = frozenset(external)
        self._most_held = most_held
        self._held: dict[int, RecordedCycle] = {}
        self._held_messages = 0
        self._next = 0

    def __iter__(self) -> Iterator[RecordedCycle]:
        for port, message in self._deliveries:
            self.read += 1
            if not port.signal.decided:
                self.not_decided += 1
            elif self._keep(port, message):
                slowest = min(self.newest.values())
                while self._next < slowest - _MARGIN:
                    yield self._pop()
            if self._held_messages >= self._most_held:
                yield self._pop()
        self.ended = True
        while self._held:
            yield self._pop()

    def _keep(self, port: Port[Message], message: Message) -> bool:
        """Keep a message; return whether its agent has gone on to another cycle by it."""
        number, agent = message.cycle, port.publisher
        if not self._next <= number < self._cycles:
            if 0 <= number < self._next or agent in self._external:
                self.too_late[agent] += 1
            else:
                self.strays += 1
            return False
        cycle = self._held.get(number)
        if cycle is None:
            cycle = self._held[number] = RecordedCycle(number)
        if port in cycle.messages:
            cycle.repeated.append((port, message))
        else:
            cycle.messages[port] = message
        self._held_messages += 1
        if number <= self.newest[agent]:
            return False
        self.newest[agent] = number
        return True

    def _pop(self) -> RecordedCycle:
        cycle = self._held.pop(self._next, None) or RecordedCycle(self._next)
        self._held_messages -= len(cycle.messages) + len(cycle.repeated)
        self._next += 1
        return cycle
