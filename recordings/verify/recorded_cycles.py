"""The messages of a recording cycle by cycle, with a bounded number of them in memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Final, TypeAlias

from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.messages import Message, Takeover
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER
from recordings.verify.comparison import NOT_COMPARED

_READ_AHEAD: Final = 50_000
_CYCLES_AHEAD: Final = 50
"""Messages, and cycles of them at least, that are read before a cycle counts as complete: the file
mixes neighbouring cycles, since agents are not equally fast."""

RecordedCycle: TypeAlias = dict[Port[Message], list[Message]]
"""The messages of a cycle by port, in the order in which the recorder heard them."""


class RecordedCycles:
    """The cycles of a recording in order.

    Without a `stop_cycle` the run broke off: incomplete cycles at its end are left out.

    Of the messages that are read, some are in no cycle: those that no agent decides, misplaced ones
    that belong to no cycle of the run or come long after theirs, and those that are cut off: of
    cycles at the end that did not take place or are incomplete. `takeovers` are what standbys said
    as they took over, by agent and incarnation.
    """

    def __init__(
        self, deliveries: Iterable[Delivery], plan: RunPlan, stop_cycle: int | None
    ) -> None:
        self.read = self.not_decided = self.misplaced = self.cut_off = 0
        self.takeovers: dict[tuple[str, int], Takeover] = {}
        self._deliveries = deliveries
        self._external = plan.external
        self._cycles = plan.cycles
        self._broke_off = stop_cycle is None
        self._end = plan.cycles if stop_cycle is None else stop_cycle
        longest = plan.periods.longest
        self._most_waiting = max(_READ_AHEAD, len(plan.wiring.ports) * (longest + _CYCLES_AHEAD))
        self._kept_cycles = plan.hold_cycles + longest
        self._messages: dict[int, RecordedCycle] = {}
        self._waiting = 0
        self._next = 0
        # The newest cycle of each process of each agent.
        self._spoke: dict[str, dict[int, int]] = {agent: {} for agent in plan.tree.agents()}

    def on(self, port: Port[Message], cycle: int) -> Sequence[Message]:
        """Return what came on a port in one of the newest cycles."""
        return self._messages.get(cycle, {}).get(port, ())

    def has_two_senders(self, port: Port[Message], cycle: int) -> bool:
        """Whether two programs said different things on a port in one of the newest cycles.

        Of a device that repeats itself the first message counts.
        """
        first, *others = self.on(port, cycle)
        return port.publisher not in self._external and any(
            _of_two_senders(first, other) for other in others
        )

    def may_lack(self, publisher: str, cycle: int) -> bool:
        """Whether a process of an agent may have spoken in a cycle unheard by the recorder.

        A process that is killed as it sends may reach some of its listeners, and not the recorder.
        """
        processes = sorted(self._spoke[publisher].items())
        return any(spoke <= cycle <= joined for (_, spoke), (joined, _) in pairwise(processes))

    def was_killed_in(self, publisher: str, incarnation: int, cycle: int) -> bool:
        """Whether a process of an agent was replaced after a cycle, and last spoke in it."""
        spoke = self._spoke[publisher]
        return max(spoke, default=0) > incarnation and spoke.get(incarnation, -1) <= cycle

    def __iter__(self) -> Iterator[tuple[int, RecordedCycle]]:
        for port, message in self._deliveries:
            self.read += 1
            if port.signal.decided:
                self._add(port, message)
            else:
                self.not_decided += 1
                if isinstance(message, Takeover):
                    self.takeovers[port.publisher, message.incarnation] = message
            while self._waiting > self._most_waiting:
                yield self._pop()
        complete = self._end
        if self._broke_off:  # Then no agent may have completed the cycle that it came to.
            own = self._spoke.keys() - {RECORDER, *self._external}
            complete = min(max(self._spoke[agent].values(), default=-1) for agent in own)
        while self._next < complete and self._waiting:
            yield self._pop()
        self.cut_off += self._waiting

    def _add(self, port: Port[Message], message: Message) -> None:
        number, agent = message.cycle, port.publisher
        if self._next <= number < self._end:
            self._messages.setdefault(number, {}).setdefault(port, []).append(message)
            self._waiting += 1
            spoke = self._spoke[agent]
            spoke[message.incarnation] = max(number, spoke.get(message.incarnation, -1))
        elif self._end <= number < self._cycles:  # Agents may begin what did not take place.
            self.cut_off += 1
        elif agent not in self._external:  # A device may send anything.
            self.misplaced += 1

    def _pop(self) -> tuple[int, RecordedCycle]:
        number, self._next = self._next, self._next + 1
        self._messages.pop(number - self._kept_cycles - 1, None)
        messages = self._messages.get(number, {})
        self._waiting -= sum(map(len, messages.values()))
        return number, messages


def _of_two_senders(one: Message, other: Message) -> bool:
    """Whether two messages of a port and cycle are not of one sender, or of its successor."""
    if one.incarnation != other.incarnation:
        return False
    undecided = dict.fromkeys(NOT_COMPARED, 0)
    return encode(replace(one, **undecided)) != encode(replace(other, **undecided))
