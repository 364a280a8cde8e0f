"""Presence and silence: one table of the processes and external agents of a run.

The launcher sees the agents through the recorder: while that is
unresponsive, nothing is known of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from agents.plan import RunPlan
from agents.process.agent_process import ALIVE_S
from agents.process.events import Event, Presence, Status
from bus_schemas.tree import PLANT, RECORDER, agent_of

PATIENCE_S: Final = 10.0
"""How long the recorder may stand still in real time, where messages queue up for it meanwhile; or
may take to come back, where it is started again."""

HEARTBEAT_S: Final = 2.0
"""The recorder reports a few times a second: silence for this long is a fault."""

PLANT_S: Final = 5.0
"""How long a cycle of the plant may take; cycles that are long on the wall clock get more."""

LONGEST_STEP_S: Final = 0.5
"""Between two looks no more than this counts as silence: a launcher or a machine that stood still
proves nothing."""

_PER_PROCESS_S: Final = 0.01
"""How long recorder and plant may at least take for each process: 1,000 share few processors."""

State: TypeAlias = Literal["awaited", "started", "present", "gone", "ended"]
"""Not seen yet; started by the launcher; on the bus; its liveliness token has disappeared; its
process has ended."""


@dataclass
class Row:
    """A process of the run, or an agent that the launcher does not start.

    unheard_s: For how long nothing was heard of it, in time in which the launcher itself ran [s].
    looked_at: Up to when that was counted, monotonic [s].
    """

    name: str
    state: State = "awaited"
    unheard_s: float = 0.0
    looked_at: float = 0.0

    def hear(self, now_s: float, state: State | None = None) -> None:
        """Note a sign of life, maybe with a new state."""
        self.unheard_s, self.looked_at = 0.0, now_s
        self.state = state or self.state

    def count_unheard(self, now_s: float) -> float:
        """Count the time since the last look as silence; return the silence before."""
        before_s = self.unheard_s
        self.unheard_s += min(now_s - self.looked_at, LONGEST_STEP_S)
        self.looked_at = now_s
        return before_s


class Watch:
    """The table of a run. `say` shows a line to the user, `now_s` is the monotonic clock.

    own: Rows of the launcher's processes, which note what these say of themselves.
    speakers: The process that speaks for each agent with a standby, and since which cycle.
    unheard: Keys on which nothing came from external agents in the newest arming round.
    complete_at: When all external agents had been seen; None: some have not.
    """

    def __init__(
        self,
        plan: RunPlan,
        own: Mapping[str, Row],
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.rows = dict(own) | {name: Row(name) for name in plan.elsewhere if name not in own}
        self.speakers = {agent: (agent, 0) for agent in plan.standbys}
        self.unheard: Sequence[str] = ()
        self.complete_at = None if plan.elsewhere else now_s()
        self._plan = plan
        self._own = own
        self._say = say
        self._now_s = now_s
        least_s = _PER_PROCESS_S * len(plan.processes)
        patience_s = HEARTBEAT_S if plan.timing.lockstep else PATIENCE_S
        if plan.restarts:  # Before that it is killed, and a new one begins.
            patience_s = plan.supervision.restart.frozen_s + PATIENCE_S
        self._recorder_s = max(patience_s, least_s)
        self._cycle_s = max(PLANT_S, least_s, 3.0 * plan.timing.cycle_wall_ns / 1e9)
        self._cycle = -1

    def begin(self) -> None:
        """Count silence from now on: cycle 0 begins."""
        for row in self.rows.values():
            row.hear(self._now_s())

    @property
    def awaited(self) -> list[str]:
        """The external agents that have not been seen."""
        return [name for name in self._plan.elsewhere if self.rows[name].state == "awaited"]

    def speaker(self, agent: str) -> str:
        """Return the process that speaks for an agent: its first one or its standby."""
        return self.speakers.get(agent, (agent, 0))[0]

    # What is heard --------------------------------------------------------------------------------

    def hear(self, event: Event) -> None:
        """Take in what the recorder says of the others."""
        now_s = self._now_s()
        match event:
            case Status():
                self.rows[RECORDER].hear(now_s)
                self.unheard = event.unheard
                if event.cycle != self._cycle:
                    self._cycle = event.cycle
                    self._hear_plant(now_s)
            case Presence():
                self._say(self._presence(event, self.rows[event.agent], now_s))

    def _hear_plant(self, now_s: float) -> None:
        if self.rows[PLANT].state != "gone":
            self.rows[PLANT].hear(now_s)

    def _presence(self, event: Presence, row: Row, now_s: float) -> str:
        """Note that an external agent has appeared or disappeared; return a message about it."""
        agent, plan = event.agent, self._plan
        name = f"{agent} ({plan.access.addresses.get(agent, 'external')})"
        when = f"in cycle {event.cycle}" if event.cycle >= 0 else "before cycle 0"
        was = row.state
        if not event.alive:
            if event.cycle >= 0 and not plan.timing.lockstep and agent != PLANT:
                return f"{name} is gone {when}; the run goes on without it"
            if event.cycle >= 0 and agent in plan.access.external:
                row.hear(now_s, "gone")
            return f"{name} is gone {when}"
        # In lockstep no message is sent twice: a device that comes back lacks what it missed.
        if was != "gone" or not plan.timing.lockstep:
            row.hear(now_s, "present")
        if was != "awaited":
            return f"{name} is back {when}"
        if not self.awaited:
            self.complete_at = now_s
        return f"{name} is here"

    def take_over(self, name: str, cycle: int) -> bool:
        """Note that a process speaks for its agent from a cycle on.

        Returns False if both processes of the agent took over at once: neither would yield, and the
        first one is to speak.
        """
        agent = agent_of(name)
        before, since = self.speakers[agent]
        are_both = since == cycle and before != name
        self.speakers[agent] = (agent if are_both else name, cycle)
        return not are_both

    # Silence --------------------------------------------------------------------------------------

    def failure(self) -> tuple[str, str] | None:
        """Return who was not heard for so long that the run has failed, and a message about it.

        To be called several times a second.
        """
        now_s, recorder, plant = self._now_s(), self.rows[RECORDER], self.rows[PLANT]
        before_s = recorder.count_unheard(now_s)
        if recorder.unheard_s > self._recorder_s:
            return RECORDER, f"recorder has been unresponsive for {self._recorder_s:g} s"
        if recorder.unheard_s > HEARTBEAT_S:
            if before_s <= HEARTBEAT_S:
                self._say(f"recorder has been unresponsive for {HEARTBEAT_S:g} s")
            self._hear_plant(now_s)
        elif plant.state != "gone":
            plant.count_unheard(now_s)
            if plant.unheard_s > self._cycle_s:
                return PLANT, f"plant has not completed a cycle for {self._cycle_s:g} s"
        for name in self._plan.access.external:
            row = self.rows[name]
            if row.state == "gone":
                row.count_unheard(now_s)
                if row.unheard_s > HEARTBEAT_S:
                    return name, f"{name} is gone: the run cannot go on without it"
        return None

    def unresponsive(self, unheard: Collection[str], unheard_s: float) -> Iterator[str]:
        """Yield the controllers that were not heard for longer than the policy allows.

        To be called again and again with the agents that were not heard for `unheard_s` or longer.
        A process that stands by is not heard, but says so every now and then.
        """
        now_s, frozen_s = self._now_s(), self._plan.supervision.restart.frozen_s
        for name, row in self._own.items():
            agent = agent_of(name)
            speaks = self.speaker(agent) == name
            if name in {PLANT, RECORDER}:
                continue
            if row.state in {"awaited", "ended"} or (speaks and agent not in unheard):
                row.hear(now_s)
                continue
            before_s = row.count_unheard(now_s)
            if speaks and 0.0 < before_s <= LONGEST_STEP_S < row.unheard_s:
                self._say(f"{name} says nothing")
            longest_s = frozen_s - unheard_s if speaks else frozen_s + 2.0 * ALIVE_S
            if before_s and row.unheard_s >= longest_s:
                yield name
