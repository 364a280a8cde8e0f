"""The messages of a recording cycle by cycle, with a bounded number of them in memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.messages import Message, Takeover
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER
from recordings.verify.comparison import NOT_COMPARED

MOST_WAITING: Final = 200_000
"""Most messages that wait for an agent that is late or has ended: about 100 MB."""

_MARGIN: Final = 20
"""Messages of one agent may overtake each other by this many cycles on the way to the recorder."""


@dataclass(slots=True)
class RecordedCycle:
    """The message of each port in a cycle that its listeners heard first, and further ones."""

    number: int
    messages: dict[Port[Message], Message] = field(default_factory=dict)
    repeated: list[Delivery] = field(default_factory=list)


class RecordedCycles:
    """The cycles of a recording in order, each as soon as it is complete.

    The file mixes the messages of neighbouring cycles, since agents are not equally fast. A cycle
    is complete when every agent has gone on to a later one.

    Without a `stop_cycle` the run broke off: incomplete cycles at its end are left out. When
    `most_waiting` messages wait, the oldest cycle counts as complete.

    Of the messages that are read, some are in no cycle: those that no agent decides, misplaced ones
    that belong to no cycle of the run or come long after theirs, and those that are cut off: of
    cycles at the end that did not take place or are incomplete. `takeovers` are what standbys said
    as they took over, by agent and incarnation.

    Of the newest cycles that were yielded, `heard` has what came on each port: as many messages as
    an agent can still use, the one first that its listeners heard first.
    """

    def __init__(
        self,
        deliveries: Iterable[Delivery],
        plan: RunPlan,
        stop_cycle: int | None,
        most_waiting: int = MOST_WAITING,
    ) -> None:
        self.read = self.not_decided = self.misplaced = self.cut_off = 0
        self._deliveries = deliveries
        self._external = plan.external
        self._cycles = plan.cycles
        self._broke_off = stop_cycle is None
        self._end = plan.cycles if stop_cycle is None else stop_cycle
        self._most_waiting = max(most_waiting, len(plan.wiring.ports) * (plan.periods.longest + 2))
        self._newest = {agent: -1 for agent in plan.tree.agents() if agent != RECORDER}
        self._waiting: dict[int, RecordedCycle] = {}
        self._waiting_messages = 0
        self._next = 0
        self._incarnation: dict[Port[Message], int] = {}
        # The newest cycle of each process of each agent.
        self._spoke: dict[str, dict[int, int]] = {agent: {} for agent in plan.tree.agents()}
        self.takeovers: dict[tuple[str, int], Takeover] = {}
        self.heard: dict[Port[Message], dict[int, list[Message]]] = {
            port: {} for port in plan.wiring.ports
        }
        self._most_heard = plan.hold_cycles + 2

    def has_two_senders(self, port: Port[Message], cycle: int) -> bool:
        """Whether two programs said different things on a port in one of the newest cycles.

        Of a device that repeats itself the first message counts.
        """
        first, *others = self.heard[port][cycle]
        return port.publisher not in self._external and any(
            _of_two_senders(first, other) for other in others
        )

    def may_lack(self, publisher: str, cycle: int) -> bool:
        """Whether a process of an agent may have spoken in a cycle unheard by the recorder.

        A process that is killed as it sends may reach some of its listeners, and not the recorder.
        """
        processes = sorted(self._spoke[publisher].items())
        return any(spoke <= cycle <= joined for (_, spoke), (joined, _) in pairwise(processes))

    def __iter__(self) -> Iterator[RecordedCycle]:
        for port, message in self._deliveries:
            self.read += 1
            if not port.signal.decided:
                self.not_decided += 1
                if isinstance(message, Takeover):
                    self.takeovers[port.publisher, message.incarnation] = message
            elif self._add(port, message):
                slowest = min(self._newest.values())
                while self._next < slowest - _MARGIN:
                    yield self._pop()
            if self._waiting_messages >= self._most_waiting:
                yield self._pop()
        complete = self._end
        if self._broke_off:  # Then no agent may have completed the cycle that it came to.
            own = self._newest.keys() - self._external
            complete = min(self._newest[agent] for agent in own)
        while self._next < complete and self._waiting:
            yield self._pop()
        self.cut_off += self._waiting_messages

    def _add(self, port: Port[Message], message: Message) -> bool:
        """Keep a message; return whether its agent has gone on to another cycle."""
        number, agent = message.cycle, port.publisher
        if not self._next <= number < self._end:
            if self._end <= number < self._cycles:  # Agents may begin what did not take place.
                self.cut_off += 1
            elif agent not in self._external:  # A device may send anything.
                self.misplaced += 1
            return False
        cycle = self._waiting.setdefault(number, RecordedCycle(number))
        newest = self._incarnation.get(port, 0)
        self._incarnation[port] = max(newest, message.incarnation)
        spoke = self._spoke[agent]
        spoke[message.incarnation] = max(number, spoke.get(message.incarnation, -1))
        # What a process that was replaced sends later, nobody uses.
        if port in cycle.messages or message.incarnation < newest:
            cycle.repeated.append((port, message))
        else:
            cycle.messages[port] = message
        self._waiting_messages += 1
        if number <= self._newest[agent]:
            return False
        self._newest[agent] = number
        return True

    def _pop(self) -> RecordedCycle:
        cycle = self._waiting.pop(self._next, None) or RecordedCycle(self._next)
        self._waiting_messages -= len(cycle.messages) + len(cycle.repeated)
        self._next += 1
        for port, message in (*cycle.messages.items(), *cycle.repeated):
            heard = self.heard[port]
            heard.setdefault(cycle.number, []).append(message)
            if len(heard) > self._most_heard:
                del heard[next(iter(heard))]
        return cycle


def _of_two_senders(one: Message, other: Message) -> bool:
    """Whether two messages of a port and cycle are not of one sender, or of its successor."""
    if one.incarnation != other.incarnation:
        return False
    undecided = dict.fromkeys(NOT_COMPARED, 0)
    return encode(replace(one, **undecided)) != encode(replace(other, **undecided))
