"""Walks through a recording cycle by cycle, with a bounded number of messages in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Run
from bus_schemas.missing import skipped_cycles
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
        The message of each port; of a port that spoke twice the first one.
    repeated
        The further ones.
    took_place
        False: by the plant's word the run ended before it. Some may have begun it all the same.
    skipped_by
        Agents that gave it up, since it was over before they came to it.
    not_awaited
        Agents whose words of this cycle may lie further on in the file, too far to be waited for.
    """

    number: int
    messages: dict[Port[Message], Message] = field(default_factory=dict)
    repeated: list[Delivery] = field(default_factory=list)
    took_place: bool = True
    skipped_by: frozenset[str] = frozenset()
    not_awaited: frozenset[str] = frozenset()

    def words(self, port: Port[Message]) -> tuple[Message, ...]:
        """Return all messages of a port, the first one first."""
        if port not in self.messages:
            return ()
        return (self.messages[port], *(word for other, word in self.repeated if other is port))


class CycleWalk:
    """The cycles of a recording in their order, each once it is complete.

    Messages of a cycle lie near each other in the file. In real time some of the next cycle may lie
    between them, and an agent that stood still for a while is heard late. A cycle is complete once
    every agent has gone on: each speaks in its own order, and what one hears another has said.

    Parameters
    ----------
    deliveries
        The messages in the order of the file.
    tree, cycles
        Control tree and number of cycles of the run.
    most_held
        When so many messages wait for an agent that lags behind or is dead, it is waited for no
        longer.
    external
        External agents: they may say anything of any cycle.

    Attributes
    ----------
    read
        Messages so far.
    not_decided
        Those of them that no agent decides: what a process says of the run, or of itself.
    newest
        Cycle of the newest message of each port.
    stop_cycle
        The first cycle that did not take place, by the plant's own word; None if there is none.
    strays
        Messages that belong to no cycle of the run, or lie behind the end of theirs.
    external_strays
        Those of external agents, by agent.
    not_awaited
        Messages, by agent, of cycles in which it was not waited for any longer.
    """

    def __init__(
        self,
        deliveries: Iterable[Delivery],
        tree: ControlTree,
        cycles: int,
        most_held: int = MOST_HELD,
        external: Collection[str] = (),
    ) -> None:
        self.read = 0
        self.not_decided = 0
        self.newest: dict[Port[Message], int] = {}
        self.stop_cycle: int | None = None
        self.strays = 0
        self.external_strays: Counter[str] = Counter()
        self.not_awaited: Counter[str] = Counter()
        self._deliveries = deliveries
        self._cycles = cycles
        self._most_held = most_held
        self._external = frozenset(external)
        self._left_behind: dict[str, int] = {}
        self._reached = {agent: -1 for agent in tree.agents() if agent != RECORDER}
        self._skipped: dict[str, list[range]] = {}
        self._held: dict[int, RecordedCycle] = {}
        self._held_messages = 0
        self._next = 0

    def __iter__(self) -> Iterator[RecordedCycle]:
        highest = -1
        for port, message in self._deliveries:
            self.read += 1
            self.not_decided += not port.signal.decided
            if isinstance(message, Run):
                self._heed(message)
            elif port.signal.decided and self._keep(port, message) and message.cycle > highest:
                highest = message.cycle
                yield from self._complete()
            if self._held_messages >= self._most_held:
                yield self._leave_behind()
        while self._next <= highest:
            yield self._pop()

    def _heed(self, message: Run) -> None:
        if message.state == "stop":
            self.stop_cycle = message.cycle

    def _keep(self, port: Port[Message], message: Message) -> bool:
        if not self._next <= message.cycle < self._cycles:
            self._count_stray(port.publisher, message.cycle)
            return False
        cycle = self._held.setdefault(message.cycle, RecordedCycle(message.cycle))
        if port in cycle.messages:
            cycle.repeated.append((port, message))
        else:
            cycle.messages[port] = message
        self._held_messages += 1
        if message.missing and (skipped := skipped_cycles(message.missing, message.cycle)):
            # Each message of a cycle says so again.
            ranges = self._skipped.setdefault(port.publisher, [])
            if skipped not in ranges[-1:]:
                ranges.append(skipped)
        self.newest[port] = max(message.cycle, self.newest.get(port, -1))
        if port.signal.decided:
            self._reached[port.publisher] = max(message.cycle, self._reached[port.publisher])
        return True

    def _count_stray(self, agent: str, cycle: int) -> None:
        if agent in self._external:
            self.external_strays[agent] += 1
        elif 0 <= cycle <= self._left_behind.get(agent, -1):
            self.not_awaited[agent] += 1
        else:
            self.strays += 1

    def _complete(self) -> Iterator[RecordedCycle]:
        """Yield the cycles that every agent has left behind."""
        slowest = min(self._reached.values())
        while self._next < slowest - _MARGIN:
            yield self._pop()

    def _leave_behind(self) -> RecordedCycle:
        """Return the next cycle, although some have not left it: they are waited for no longer."""
        cycle = self._pop()
        cycle.not_awaited = frozenset(
            agent for agent, reached in self._reached.items() if reached <= cycle.number + _MARGIN
        )
        self._left_behind.update(dict.fromkeys(cycle.not_awaited, cycle.number))
        return cycle

    def _pop(self) -> RecordedCycle:
        cycle = self._held.pop(self._next, None) or RecordedCycle(self._next)
        self._held_messages -= len(cycle.messages) + len(cycle.repeated)
        # The plant's word stands at the end of the file, and the last cycles are kept until then.
        cycle.skipped_by = self._skipped_by(self._next)
        cycle.took_place = self.stop_cycle is None or cycle.number < self.stop_cycle
        self._next += 1
        return cycle

    def _skipped_by(self, cycle: int) -> frozenset[str]:
        """Return who gave a cycle up, and forget about those before it.

        They say so in the next one that they go through, and it is waited for.
        """
        if not self._skipped:
            return frozenset()
        agents = frozenset(
            agent
            for agent, ranges in self._skipped.items()
            if any(cycle in skipped for skipped in ranges)
        )
        to_come = {
            agent: [skipped for skipped in ranges if skipped.stop > cycle + 1]
            for agent, ranges in self._skipped.items()
        }
        self._skipped = {agent: ranges for agent, ranges in to_come.items() if ranges}
        return agents
