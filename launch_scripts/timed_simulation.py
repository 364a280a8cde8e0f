"""A run in memory on a virtual clock: real time, deadlines and an imperfect network, exactly.

Nothing waits: the clock jumps to whatever comes next, the arrival of a message or the deadline of
a stage. The agents decide in no time at all, and a message takes as long as the faults of the
network let it take. So what a run comes to is due to the network alone, and a run that is repeated
is the same to the last bit, publish times included.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from heapq import heappop, heappush
from itertools import count
from typing import Any, TypeAlias

from msgspec.structs import replace

from agents.agent import Agent
from agents.plan import RunPlan
from agents.sequencer import Sequencer
from agents.team import controllers
from bus_schemas.bus import Delivery, Outbox
from bus_schemas.faults import FaultTally
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port, listeners
from bus_schemas.tree import PLANT, ROOT
from sim_plant.plant import Plant
from sim_plant.profile import Profile

OpenStage: TypeAlias = tuple[int, str]
"""A cycle and the stage of it that an agent is in; the stage is empty where it is in none."""


def on_the_clock(plan: RunPlan) -> RunPlan:
    """Return the plan with a length for its cycles: in real time if it was to be in lockstep."""
    return replace(plan, cycle_wall_ns=plan.cycle_wall_ns or plan.cycle_ns)


class TimedRun:
    """A run in memory, in virtual time.

    Parameters
    ----------
    plan
        The run, with a length for its cycles, see `on_the_clock`.
    profile
        What sun and market do.
    tap
        Called with every message that is sent, with its port, as a recorder would hear it.

    Attributes
    ----------
    now_ns
        The virtual clock: time since cycle 0 [ns].
    tally
        What the faults did to messages.
    """

    def __init__(
        self,
        plan: RunPlan,
        profile: Profile,
        tap: Callable[[Port[Message], Message], None] = lambda port, message: None,
    ) -> None:
        self.plan = plan
        self.now_ns = 0
        self.tally = FaultTally()
        team: list[Agent[Any]] = [Plant(plan.tree, profile, plan.actuator), *controllers(plan)]
        self.sequencers = {
            agent.name: Sequencer(
                agent,
                plan.sim_time_ns,
                lockstep=False,
                horizon=plan.periods.longest,
                late=plan.late,
            )
            for agent in team
        }
        for sequencer in self.sequencers.values():
            sequencer.end_before(plan.cycles)
        self._outbox = Outbox(lambda: self.now_ns)
        self._tap = tap
        self._arrived: deque[tuple[str, Port[Message], Message]] = deque()
        # The numbers keep the order of what happens at one moment, and messages uncompared.
        self._numbers = count()
        self._under_way: list[tuple[int, int, str, Port[Message], Message]] = []
        self._deadlines: list[tuple[int, int, str, OpenStage]] = []
        self._open: dict[str, OpenStage] = {}
        self._listeners: dict[Port[Message], tuple[str, ...]] = {}
        self._deadlines_ns: dict[tuple[str, str], int] = {}

    def cycles(self) -> Iterator[int]:
        """Run cycle after cycle; yield the number of each once the plant has finished it."""
        plant = self.sequencers[PLANT]
        self._publish(RUN.of(ROOT), self.plan.run_message("start", 0, 0))
        for name, sequencer in self.sequencers.items():
            self._go_on(name, sequencer, sequencer.enter(0))
        done = 0
        while self._next():
            while done < plant.cycle:
                yield done
                done += 1
            if plant.finished and self._all_finished():
                return

    @property
    def published(self) -> Counter[str]:
        """Messages published so far, by signal."""
        return self._outbox.published

    @property
    def faults(self) -> dict[str, int]:
        """What the imperfect network did to messages."""
        return self.tally.as_counts()

    def stop(self) -> None:
        """End the run after the cycle under way."""
        plant = self.sequencers[PLANT]
        if plant.end_cycle == self.plan.cycles:
            last = min(plant.cycle + 1, self.plan.cycles)
            for sequencer in self.sequencers.values():
                sequencer.end_before(last)

    def close(self) -> None:
        """Say that the run is over."""
        last = self.sequencers[PLANT].cycle
        self._publish(RUN.of(ROOT), self.plan.run_message("stop", last, 0))

    def _next(self) -> bool:
        """Let the next thing happen; return whether there was one."""
        if self._arrived:
            self._hand_over(*self._arrived.popleft())
            return True
        if not self._deadlines:
            return False
        # A message that arrives at a deadline is in time.
        if self._under_way and self._under_way[0][0] <= self._deadlines[0][0]:
            self.now_ns, _, name, port, message = heappop(self._under_way)
            self._hand_over(name, port, message)
            return True
        self.now_ns, _, name, open_stage = heappop(self._deadlines)
        if self._open[name] == open_stage:
            sequencer = self.sequencers[name]
            self._go_on(name, sequencer, sequencer.close_stage())
        return True

    def _hand_over(self, name: str, port: Port[Message], message: Message) -> None:
        sequencer = self.sequencers[name]
        self._go_on(name, sequencer, sequencer.accept(port, message))

    def _go_on(self, name: str, sequencer: Sequencer[Any], outputs: list[Delivery]) -> None:
        """Send what an agent says, and set the clock for the stage that it is in now."""
        for port, message in outputs:
            self._publish(port, message)
        open_stage = (sequencer.cycle, sequencer.stage)
        if open_stage != self._open.get(name):
            self._open[name] = open_stage
            if open_stage[1]:
                # A stage that opens after its deadline closes at once: time does not go back.
                closes_ns = max(self._deadline_ns(name, *open_stage), self.now_ns)
                heappush(self._deadlines, (closes_ns, next(self._numbers), name, open_stage))

    def _publish(self, port: Port[Message], message: Message) -> None:
        stamped = self._outbox.stamp(port, message)
        self._tap(port, stamped)
        if port.signal is RUN:
            return  # Here everybody knows by itself.
        heard_by = self._listeners.get(port)
        if heard_by is None:
            heard_by = self._listeners[port] = listeners(port, self.plan.tree)
        for listener in heard_by:
            fate = self.plan.network_faults.fates(port, listener, stamped)
            self.tally.count(fate)
            for delay_ns in fate:
                if delay_ns:
                    due_ns = self.now_ns + delay_ns
                    arrival = (due_ns, next(self._numbers), listener, port, stamped)
                    heappush(self._under_way, arrival)
                else:
                    self._arrived.append((listener, port, stamped))

    def _deadline_ns(self, name: str, cycle: int, stage: str) -> int:
        after_ns = self._deadlines_ns.get((name, stage))
        if after_ns is None:
            after_ns = self.plan.deadlines.deadline_ns(name, stage)
            self._deadlines_ns[name, stage] = after_ns
        return cycle * self.plan.cycle_wall_ns + after_ns

    def _all_finished(self) -> bool:
        return all(sequencer.finished for sequencer in self.sequencers.values())
