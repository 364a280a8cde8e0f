"""Takes one agent through its cycles: hears its inputs, closes its stages, goes on.

There is one rule for time. The newest message of each input is kept. A stage closes when every
input that it awaits is of this cycle, or at its deadline (in lockstep there is none). The agent
decides on the newest messages that have not expired.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from typing import Final, Generic, TypeVar

from agents.agent import Agent, Stage, Turn
from agents.inputs import Input, Inputs
from agents.plan import RunPlan
from agents.run_times import RunTimes
from bus_schemas.bounds import is_within
from bus_schemas.bus import Cause, Delivery
from bus_schemas.messages import GivenUp, Message, Order, Run
from bus_schemas.signals import DISPATCH, RUN, Port
from bus_schemas.tree import ROOT

S = TypeVar("S")

log = logging.getLogger(__name__)

BEFORE_ARMING: Final = -(2**31)
"""The cycle that an agent is in before the first arming round."""

_PLANT_HORIZON: Final = 1_000
"""Cycles by which controllers may be ahead of a plant that stood still."""

_DISPATCH: Final = DISPATCH.of(ROOT)


class Loop(Generic[S]):
    """One agent on its way through the cycles.

    Arming rounds are cycles below 0. Each begins from the initial state and leaves no trace. The
    dispatch of a round takes a controller into it, and the plant's `run` into cycle 0.

    on_drop: See `Inputs`.

    incarnation: The cycle in which its process joined the run: 0, unless it replaces another.
    waiting: Ports on which the open stage still awaits a message.
    deadline_ns: When the open stage closes at the latest, on the run's clock. None: it waits.
    """

    def __init__(
        self,
        agent: Agent[S],
        plan: RunPlan,
        on_drop: Callable[[int, str], None] = lambda count, why: None,
    ) -> None:
        self.agent = agent
        self.name = agent.name
        # The plant, which goes through every cycle, hears controllers that did not wait for it.
        horizon = plan.control.periods.longest + 1 if agent.may_skip else _PLANT_HORIZON
        self.inputs = Inputs(plan, agent.name, horizon, on_drop)
        self.times = RunTimes(plan, agent)
        self.incarnation = 0
        self.cycle = BEFORE_ARMING
        self.waiting: set[Port[Message]] = set()
        self.deadline_ns: int | None = None
        self._state = agent.initial_state()
        self._stages: tuple[Stage, ...] = ()
        self._position = 0
        self._sim_time_ns = 0
        self._ready_ns = 0

    @property
    def stage(self) -> str:
        stages, position = self._stages, self._position  # Another thread may be at work on them.
        return stages[position].name if position < len(stages) else ""

    @property
    def needs(self) -> list[tuple[str, str]]:
        """Key and publisher of each message that the open stage still awaits."""
        return [(str(port), port.publisher) for port in sorted(self.waiting, key=str)]

    @property
    def finished(self) -> bool:
        return self.cycle >= self.times.end_cycle

    # What comes in --------------------------------------------------------------------------------

    def hear(self, port: Port[Message], message: Message, time_ns: int) -> None:
        """Take in a message that came at a time of the run's clock."""
        if port is _DISPATCH and self.times.is_estimated and message.source == port.publisher:
            self._follow_clock(message, time_ns)
        inputs, cycle = self.inputs, self.cycle
        one = inputs.of.get(port)
        if message.source != port.publisher:
            inputs.drop(Cause.WRONG_SENDER, port, message, f"is from {message.source!r}", cycle)
        elif one is None:
            self._hear_event(port, message, time_ns)
        elif not message.cycle < 0 <= cycle and inputs.take(one, message, cycle):
            if port is _DISPATCH:
                self._hear_dispatch(one, message, time_ns)
            if message.cycle == cycle and port in self.waiting:
                self.waiting.discard(port)
                if not self.waiting:
                    self._ready_ns = time_ns

    def _follow_clock(self, dispatch: Message, time_ns: int) -> None:
        """Go to the cycle under way if the message that set the clock had come late."""
        if self.cycle >= 0 and self.times.begins_earlier(dispatch, time_ns):
            self.catch_up(time_ns)

    def _hear_dispatch(self, one: Input, dispatch: Message, time_ns: int) -> None:
        """Follow the plant to another round, into a run under way, or on after a stop."""
        if self.cycle < 0 and dispatch.cycle > self.cycle and is_within(dispatch, one.bounds):
            if dispatch.cycle < 0:
                self.enter(dispatch.cycle, time_ns)
            elif dispatch.cycle > 0:
                self._join(dispatch, time_ns)
        if self.times.end_cycle <= dispatch.cycle:
            self._forget_false_stop(dispatch, time_ns)

    def _hear_event(self, port: Port[Message], message: Message, time_ns: int) -> None:
        match message:
            case Run():
                self._hear_run(port, message, time_ns)
            case GivenUp():
                self.give_up(message.agents, time_ns)
            case Order():
                self.inputs.take_order(port, message, self.cycle)

    def _hear_run(self, port: Port[Message], run: Run, time_ns: int) -> None:
        if run.state == "stop":
            if run.cycle <= self.inputs.of[_DISPATCH].newest_cycle:
                why = "ends a cycle that the plant has begun"
                self.inputs.drop(Cause.CONFLICTING, port, run, why, self.cycle)
                return
            self.end_before(run.cycle)
            self.times.stop_heard = True
        elif self.cycle < 0:
            self.begin(self.times.on_this_clock(run.start_time_ns, time_ns), time_ns)

    def _forget_false_stop(self, dispatch: Message, now_ns: int) -> None:
        """Go on with the run: the plant has begun a cycle after the stop."""
        why = f"stopped the run before cycle {self.times.end_cycle}, which the plant has begun"
        self.inputs.drop(Cause.CONFLICTING, RUN.of(ROOT), dispatch, why, self.cycle)
        was_finished = self.finished
        self.times.end_cycle, self.times.stop_heard = self.times.timing.cycles, False
        if was_finished:
            self._go_to(self.cycle, now_ns)

    # Cycles ---------------------------------------------------------------------------------------

    def begin(self, start_ns: int, now_ns: int, cycle: int = 0) -> None:
        """Enter the first cycle of a run; cycle 0 begins at a time of the run's clock."""
        self.times.start(start_ns)
        self.incarnation = cycle
        self.enter(cycle, now_ns)

    def _join(self, dispatch: Message, now_ns: int) -> None:
        """Join a run under way: the dispatch says in which cycle it is, and since when."""
        cycle, times = dispatch.cycle, self.times
        start_ns = times.start_by(dispatch, now_ns)
        times.start(start_ns)
        # A dispatch that was long on its way is of a cycle that is over: no stage of it is left.
        cycle = times.goes_on_in(cycle, now_ns) or cycle
        log.info("joined the run in cycle %d", cycle)
        self.begin(start_ns, now_ns, cycle)
        if dispatch.cycle < cycle:
            self.inputs.take(self.inputs.of[_DISPATCH], dispatch, cycle)

    def end_before(self, cycle: int) -> None:
        """Let the run end before a cycle."""
        self.times.end_cycle = min(self.times.end_cycle, cycle)
        if self.finished:
            self._stages, self.waiting, self.deadline_ns = (), set(), None

    def give_up(self, agents: Collection[str], now_ns: int) -> None:
        """Await nothing more of agents that do not come back."""
        gone = {port for port in self.inputs.of if port.publisher in agents}
        self.inputs.given_up |= gone
        if self.waiting and self.waiting <= gone:
            self._ready_ns = now_ns
        self.waiting -= gone

    def enter(self, cycle: int, now_ns: int) -> None:
        """Enter an arming round or cycle 0, from the initial state."""
        self._state = self.agent.initial_state()
        self.inputs.forget_before(cycle)
        self._go_to(cycle, now_ns)

    def catch_up(self, now_ns: int) -> bool:
        """Go to the cycle under way if the own cycle is over; return whether it was."""
        under_way = None if self.finished else self.times.goes_on_in(self.cycle, now_ns)
        if under_way is None:
            return False
        if not self.agent.may_skip:
            log.warning("cycles %d to %d are missed: they were over", self.cycle, under_way - 1)
        self.times.skipped_cycles += under_way - self.cycle
        self._go_to(under_way, now_ns)
        return True

    def _go_to(self, cycle: int, now_ns: int) -> None:
        self.cycle = cycle
        self._sim_time_ns = self.times.timing.sim_time_ns(cycle)
        self._position = 0
        self._stages = () if self.finished else self.agent.stages(cycle)
        self.inputs.go_to(cycle)
        self._open_stage(now_ns)

    def _open_stage(self, now_ns: int) -> None:
        self.waiting = set()
        self.deadline_ns = None
        self._ready_ns = now_ns
        if self._position < len(self._stages):
            stage, inputs, cycle = self._stages[self._position], self.inputs.of, self.cycle
            self.deadline_ns = self.times.deadline_ns(cycle, stage.name)
            self.waiting = {port for port in stage.awaits if inputs[port].newest_cycle != cycle}
            self.waiting -= self.inputs.given_up

    def close_stage(self, now_ns: int, *, is_overdue: bool = False) -> list[Delivery] | None:
        """Close the open stage if it is complete or overdue; return the outputs, None if not."""
        if self._position >= len(self._stages) or (self.waiting and not is_overdue):
            return None
        stage, cycle, deadline_ns = self._stages[self._position], self.cycle, self.deadline_ns
        if stage.timed and deadline_ns is not None and not is_overdue:
            return None
        if self.waiting or stage.timed:
            self._ready_ns = now_ns if deadline_ns is None else deadline_ns
            self.inputs.missing += len(self.waiting)
        inputs, missing = self.inputs.used(stage, cycle)
        sim_time_ns = self._sim_time_ns
        # The bus adds when each message goes out, and its number.
        name, incarnation = self.agent.name, self.incarnation
        stamp = (cycle, sim_time_ns, name, missing, self._ready_ns, 0, 0, incarnation)
        turn = Turn(stage.name, cycle, sim_time_ns, stamp, inputs)
        self._state, outputs = self.agent.step(self._state, turn)
        self._position += 1
        if self._position < len(self._stages):
            self._open_stage(now_ns)
        elif cycle >= 0:
            self._go_to(cycle + 1, now_ns)
        return outputs
