"""What happened in a run, as a list that the page shows: worked out from its messages."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from itertools import islice
from typing import Final

import msgspec
import numpy as np

from agents.plan import RunPlan
from bus_schemas.messages import Head, Message
from bus_schemas.signals import IMPP, TELEMETRY, Port
from bus_schemas.tree import PLANT, agent_name
from recordings.read.gaps import PortGaps
from scenarios.fault_rules import fault_text

_KEPT: Final = 500
_MERGED: Final = 40
"""An event like one of the last ones is counted with it."""

_MERGED_CYCLES: Final = 60


class Event(msgspec.Struct):
    """Something that happened, once or `count` times from `cycle` to `last_cycle`.

    `revision` grows whenever an event is new or has changed.
    """

    number: int
    revision: int
    kind: str
    cycle: int
    last_cycle: int
    agent: str
    text: str
    count: int


class RunEvents:
    """The newest events of a run: restarts, unresponsive agents, lost messages.

    It also knows in which cycles each agent was heard and began again.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.revision = 0
        agents = (PLANT, *map(agent_name, plan.tree.nodes))
        self._heard = {agent: np.zeros(plan.timing.cycles, dtype=bool) for agent in agents}
        self._restarts: defaultdict[str, list[int]] = defaultdict(list)
        self._events: deque[Event] = deque(maxlen=_KEPT)
        self._number = 0
        self._hold_cycles = plan.control.hold_cycles
        self._gaps: defaultdict[Port[Message], PortGaps] = defaultdict(PortGaps)
        # Each node states its IMPP in each cycle; a real inverter that is gone has no telemetry.
        self._names: dict[Port[Message], str] = {
            **{IMPP.of(node): agent_name(node) for node in plan.tree.nodes},
            **{TELEMETRY.of(node): f"device {node}" for node, _ in plan.site.devices},
        }
        self._heard_in = dict.fromkeys(self._names, -1)
        self._unheard_from: dict[Port[Message], int] = {}
        for fault in plan.faults.rules:
            self.add("fault", 0, "network", f"fault rule: {fault_text(fault)}")

    def add(self, kind: str, cycle: int, agent: str, text: str, count: int = 1) -> None:
        """Enter an event; one of the same kind, agent and text shortly before is counted on."""
        self.revision += 1
        for event in islice(reversed(self._events), _MERGED):
            same = (event.kind, event.agent, event.text) == (kind, agent, text)
            if same and cycle <= event.last_cycle + _MERGED_CYCLES:
                event.count += count
                event.last_cycle = max(cycle, event.last_cycle)
                event.revision = self.revision
                return
        self._number += 1
        self._events.append(
            Event(self._number, self.revision, kind, cycle, cycle, agent, text, count)
        )

    def since(self, revision: int) -> list[Event]:
        """Return the events that are newer than a revision, or have changed since."""
        return [event for event in self._events if event.revision > revision]

    def see(self, port: Port[Message], sequence: int, head: Head) -> None:
        """Take in a message, by its number on its key."""
        gaps, agent = self._gaps[port], port.publisher
        if agent in self._heard and 0 <= head.cycle < len(self._heard[agent]):
            self._heard[agent][head.cycle] = True
        lost, restarts = gaps.lost, gaps.restarts
        gaps.see(head.cycle, sequence, head.incarnation)
        if gaps.restarts > restarts and port.signal is IMPP:
            self._restarts[agent].append(head.cycle)
            self.add("restart", head.cycle, agent, "restarted")
        if gaps.lost > lost:
            self.add("lost", head.cycle, agent, "messages lost", gaps.lost - lost)
        before = self._heard_in.get(port)
        if before is not None:
            if head.cycle > before + 1 + self._hold_cycles and before >= 0:
                self._note_absence(port)
                self.add("back", head.cycle, self._names[port], "heard again")
            self._heard_in[port] = max(head.cycle, before)

    def age(self, agent: str, cycle: int) -> int | None:
        """Return the cycles since the newest message of an agent; None: there is none."""
        back = self._heard[agent][cycle::-1]
        age = int(back.argmax())
        return age if back[age] else None

    def restarts(self, agent: str, cycle: int) -> int:
        """Return how often an agent had begun again by a cycle."""
        return bisect_right(self._restarts[agent], cycle)

    def note_unresponsive(self, newest_cycle: int) -> None:
        """Note the agents that have sent nothing for longer than inputs are held."""
        for port, cycle in self._heard_in.items():
            if newest_cycle > cycle + self._hold_cycles:
                self._note_absence(port)

    def _note_absence(self, port: Port[Message]) -> None:
        begin = self._heard_in[port] + 1
        if self._unheard_from.get(port) != begin:
            self._unheard_from[port] = begin
            self.add("unresponsive", begin, self._names[port], "unresponsive")
