"""The messages of a recording cycle by cycle, with a bounded number of them in memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Final, TypeAlias

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import GivenUp, Message
from bus_schemas.signals import Port

_READ_AHEAD: Final = 50_000
_CYCLES_AHEAD: Final = 50
"""Messages, and cycles of them at least, that are read before a cycle counts as complete: the file
mixes neighbouring cycles, because some agents are ahead of others."""

RecordedCycle: TypeAlias = dict[Port[Message], list[Message]]
"""The messages of a cycle by port, in the order in which the recorder heard them."""


class RecordedCycles:
    """The cycles of a recording in order.

    Without a `stop_cycle` the run broke off: nothing is known of an agent from its newest cycle on.
    `absences` may be missing in the file, see `unrecorded_spans`. `misplaced` counts messages that
    belong to no cycle of the run, or come long after theirs.
    """

    def __init__(
        self,
        deliveries: Iterable[Delivery],
        plan: RunPlan,
        stop_cycle: int | None,
        absences: Sequence[tuple[str, range]] = (),
    ) -> None:
        self.misplaced = 0
        self._deliveries = deliveries
        self._plan = plan
        self._absences = list(absences)
        self._broke_off = stop_cycle is None
        self._end = plan.timing.cycles if stop_cycle is None else stop_cycle
        self._messages: dict[int, RecordedCycle] = {}
        self._waiting = 0
        self._next = 0
        # The newest cycle of each process of each agent.
        self._newest: dict[str, dict[int, int]] = {agent: {} for agent in plan.tree.agents()}

    def on(self, port: Port[Message], cycle: int) -> Sequence[Message]:
        return self._messages.get(cycle, {}).get(port, ())

    def may_lack(self, publisher: str, cycle: int) -> bool:
        """Whether an agent may have published in a cycle what the recorder did not hear.

        The recorder was away, or a process that was killed as it sent reached other listeners only.
        """
        processes = sorted(self._newest[publisher].items())
        return self.was_away(publisher, cycle) or any(
            newest <= cycle <= joined for (_, newest), (joined, _) in pairwise(processes)
        )

    def was_away(self, publisher: str, first: int, last: int | None = None) -> bool:
        """Whether the recorder may have missed a publisher in some cycle of these."""
        last = first if last is None else last
        return any(
            name == publisher and first < absence.stop and last >= absence.start
            for name, absence in self._absences
        )

    def __iter__(self) -> Iterator[tuple[int, RecordedCycle]]:
        plan = self._plan
        cycles_ahead = plan.control.periods.longest + _CYCLES_AHEAD
        most_waiting = max(_READ_AHEAD, len(plan.wiring.ports) * cycles_ahead)
        for port, message in self._deliveries:
            if port.signal.decided:
                self._add(port, message)
            elif isinstance(message, GivenUp):
                for agent in message.agents:
                    self._absences.append((agent, range(message.cycle, self._end)))
            while self._waiting > most_waiting:
                yield self._pop()
        if self._broke_off:  # The agents may not have completed their last cycle.
            for agent, newest in self._newest.items():
                self._absences.append((agent, range(max(newest.values(), default=0), self._end)))
        while self._waiting:
            yield self._pop()

    def _add(self, port: Port[Message], message: Message) -> None:
        cycle, agent = message.cycle, port.publisher
        if self._next <= cycle < self._end:
            self._messages.setdefault(cycle, {}).setdefault(port, []).append(message)
            self._waiting += 1
            newest = self._newest[agent]
            newest[message.incarnation] = max(cycle, newest.get(message.incarnation, -1))
            return
        # Agents may have begun a cycle that did not take place; a device may send anything.
        is_begun = self._end <= cycle < self._plan.timing.cycles
        self.misplaced += not is_begun and agent not in self._plan.access.external

    def _pop(self) -> tuple[int, RecordedCycle]:
        """Return the next cycle; forget the one that is too old for its inputs."""
        cycle, self._next = self._next, self._next + 1
        control = self._plan.control
        self._messages.pop(cycle - control.hold_cycles - control.periods.longest - 1, None)
        messages = self._messages.get(cycle, {})
        self._waiting -= sum(map(len, messages.values()))
        return cycle, messages
