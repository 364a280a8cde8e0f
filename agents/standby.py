"""An agent with two processes: which of them publishes.

A standby is a second process of an agent. It goes through the same stages without publishing, and
in each one also awaits the other process's last message of that stage. If that has not come some
time after the stage's deadline, it takes over: it publishes from this stage on, and the other
process stops publishing as soon as it hears it.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from typing import Final

from agents.agent import Stage
from agents.cycle import stage_of
from agents.inputs import Inputs
from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port

log = logging.getLogger(__name__)

_STANDBY_WAITS: Final = 0.5
_DEPOSED_WAITS: Final = 0.75
"""Part of the time up to its listeners' deadline that a silent process waits after its own: a
standby, and a process that it replaced. They differ, so that not both take over at once."""


class Standby:
    """What a process of an agent knows of the agent's other one, if there is one.

    silent: Whether the process publishes nothing, because the other one does.
    incarnation: The cycle in which the process joined the run, or took over: 0, unless it replaces
        another.
    heard: Ports on which the two processes hear each other.
    sent: The newest message that this process has published on each of them.
    """

    def __init__(self, plan: RunPlan, agent: str, process: str) -> None:
        self._is_first = process == agent
        self.silent = not self._is_first
        self.incarnation = 0
        self.heard = plan.wiring.last_ports.get(agent, ())
        self.sent: dict[Port[Message], Message] = {}
        self._agent = agent
        self._deadlines = plan.deadlines
        self._waits = _DEPOSED_WAITS if self._is_first else _STANDBY_WAITS
        self._stage_and_period = {
            port: (stage_of(port, plan.tree), plan.control.period(port)) for port in self.heard
        }

    def join(self, cycle: int) -> None:
        """Join a run under way: the agent's other process lives, or this one will take over."""
        log.info("joined the run in cycle %d", cycle)
        self.silent = bool(self.heard)

    def yield_to(self, port: Port[Message], message: Message) -> bool:
        """Fall silent if the other process has taken over; return whether it has.

        If both took over in one cycle, the agent's first process goes on.
        """
        taken_over_in = message.incarnation
        if taken_over_in == self.incarnation and not self._is_first:
            own = self.sent.get(port)  # A process hears its own messages, too.
            if own is not None and own.cycle == message.cycle:
                taken_over_in += own.publish_time_ns != message.publish_time_ns
        return self.yield_after(taken_over_in)

    def yield_after(self, taken_over_in: int) -> bool:
        """Fall silent if the other process took over in this cycle, and this one joined earlier.

        Listeners refuse it from then on, also if the other process dies before this one hears it.
        """
        if taken_over_in <= self.incarnation or self.silent:
            return False
        self.silent = True
        log.info("falls silent: the other process took over in cycle %d", taken_over_in)
        return True

    def awaited(self, stage: str, cycle: int) -> tuple[Port[Message], ...]:
        """Return the last port that the other process publishes on in a stage."""
        ports = [
            port
            for port, (of, period) in self._stage_and_period.items()
            if of == stage and (cycle < 0 or cycle % period == 0)
        ]
        return tuple(ports[-1:])

    def extra_ns(self, stage: str) -> int:
        """Return how long a silent process waits after its own deadline."""
        return round(self._waits * self._deadlines.room_ns(self._agent, stage))

    def may_take_over(
        self,
        stage: Stage,
        cycle: int,
        waiting: Collection[Port[Message]],
        inputs: Inputs,
        late_ns: int,
    ) -> bool:
        """Whether the other process has missed its deadline, which was `late_ns` ago.

        A process that comes late to a deadline itself knows nothing of the other one. One that has
        just joined leaves the standby a cycle to speak first: both would be of one incarnation.
        """
        if not any(port in waiting for port in self.heard):
            return False
        if stage.awaits and all(port in waiting for port in stage.awaits):
            return False  # It hears no agent: it is itself cut off.
        if self.incarnation and cycle <= self.incarnation + 1:
            return False
        newest = max(inputs.of[port].incarnation for port in self.heard)
        slice_ns = self._deadlines.slice_ns(self._agent, stage.name)
        return cycle > newest and late_ns <= self._waits * slice_ns

    def take_over(self, cycle: int) -> None:
        """Speak from now on."""
        log.info("takes over in cycle %d", cycle)
        self.silent, self.incarnation = False, cycle
