"""Takes one agent through its cycles: keeps its inputs, closes its stages, goes on.

There is one rule for time. The newest message of each input is kept. A stage closes when every
input that it awaits is of this cycle, or at its deadline (in lockstep there is none). The agent
decides on the newest messages; an input older than `hold_cycles` is silent. Its messages name, in
`missing`, the inputs that were older than they should have been.

A standby is a second process of an agent. It goes through the same stages without publishing,
and in each one also awaits the other process's last message of that stage. If that has not come
some time after the stage's deadline, it takes over: it publishes from this stage on, and the other
process stops publishing as soon as it hears it.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from copy import copy
from functools import cache, partial
from itertools import chain
from typing import Final, Generic, Self, TypeVar

import msgspec

from agents.agent import Agent, Stage, Turn
from agents.cycle import stage_of
from agents.plan import START_WITHIN_NS, RunPlan
from bus_schemas.bounds import bounds_of, is_within
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Run, Takeover
from bus_schemas.missing import Missing
from bus_schemas.printable import printable
from bus_schemas.signals import DISPATCH, RUN, TAKEOVER, Occurrence, Port
from bus_schemas.tree import CENTRAL, ROOT

S = TypeVar("S")

log = logging.getLogger(__name__)

BEFORE_ARMING: Final = -(2**31)
"""The cycle that an agent is in before the first arming round."""

_NONE_YET: Final = -(2**62)

_PLANT_HORIZON: Final = 1_000
"""Cycles by which controllers may be ahead of a plant that stood still."""

_STANDBY_WAITS: Final = 0.5
_DEPOSED_WAITS: Final = 0.75
"""Part of the time up to its listeners' deadline that a silent process waits after its own: a
standby, and a process that it replaced. They differ, so that not both take over at once."""

_COUNT_IN_ARMING: Final = frozenset({"foreign", "absurd"})
"""The other causes do not: arming rounds overlap while links come up."""


class _Input:
    """One input of an agent: its newest message, and those of cycles to come.

    `heard` is the newest cycle of which something came, whatever it was. A child may run ahead of a
    parent that acts rarely.
    """

    __slots__ = ("ahead", "bounds", "heard", "incarnation", "newest", "period", "port")

    def __init__(self, port: Port[Message], period: int, rating_kw: float) -> None:
        self.port = port
        self.period = period
        self.bounds = bounds_of(port.signal.type, rating_kw)
        self.forget()

    def forget(self) -> None:
        self.heard = _NONE_YET
        self.incarnation = 0
        self.newest: Message | None = None
        self.ahead: dict[int, Message] = {}


def log_drop(count: int, why: str) -> None:
    """Log the first ten dropped messages of a kind, then the 16th, 32nd, 64th and so on."""
    if count <= 10 or count & (count - 1) == 0:
        log.warning("dropped (%d of this kind): %s", count, printable(why))


class AgentLoop(Generic[S]):
    """One agent on its way through the cycles.

    Arming rounds are cycles below 0. Each begins from the initial state and leaves no trace. The
    dispatch of a round takes a controller into it, and the plant's `run` into cycle 0.

    on_drop: Called for each message that is not used: how many of its kind there were, and why.
    process: Name of its process, where it is a standby.

    end_cycle: The first cycle that does not take place.
    waiting: Ports of which the open stage still awaits a message.
    deadline_ns: When the open stage closes at the latest, on the run's clock. None: it waits.
    dropped: Messages that were not used, by port and cause.
    missing_inputs: Awaited inputs that a deadline found missing.
    old_inputs: Inputs that a stage used and that were older than they should have been.
    skipped_cycles: Cycles that were over before the agent was through them.
    incarnation: The cycle in which it joined the run, or took over: 0, unless its process replaces
        another.
    silent: Whether it publishes nothing: its agent's other process does.
    """

    def __init__(
        self,
        agent: Agent[S],
        plan: RunPlan,
        on_drop: Callable[[int, str], None] = lambda count, why: None,
        process: str | None = None,
    ) -> None:
        self.agent = agent
        self.name = process or agent.name
        self.silent = self.name != agent.name
        self.cycle = BEFORE_ARMING
        self.end_cycle = plan.cycles
        self.stop_heard = False
        self.waiting: set[Port[Message]] = set()
        self.deadline_ns: int | None = None
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.missing_inputs = 0
        self.old_inputs = 0
        self.skipped_cycles = 0
        self.incarnation = 0
        self._plan = plan
        self._on_drop = on_drop
        self._state = agent.initial_state()
        self._stages: tuple[Stage, ...] = ()
        self._place = 0
        self._ready_ns = 0
        self._start_ns: int | None = None
        # The plant, which goes through every cycle, hears controllers that did not wait for it.
        self._horizon = plan.periods.longest + 1 if agent.may_skip else _PLANT_HORIZON
        self._dispatch = DISPATCH.of(ROOT)
        self._inputs = {
            port: _Input(port, plan.period(port), plan.tree.rating_kw(port.node))
            for port in plan.wiring.heard.get(agent.name, ())
            if port.signal.occurrence is not Occurrence.EVENT
        }
        self._deadline_after_ns = cache(partial(plan.deadlines.deadline_ns, agent.name))
        self._signs = plan.wiring.signs.get(agent.name, ())
        self._waits = _STANDBY_WAITS if self.silent else _DEPOSED_WAITS

    @property
    def stage(self) -> str:
        stages, place = self._stages, self._place  # Another thread may be at work on them.
        return stages[place].name if place < len(stages) else ""

    @property
    def needs(self) -> list[tuple[str, str]]:
        """Key and publisher of each message that the open stage still awaits."""
        return [(str(port), port.publisher) for port in sorted(self.waiting, key=str)]

    @property
    def finished(self) -> bool:
        return self.cycle >= self.end_cycle

    @property
    def is_complete(self) -> bool:
        if self.waiting or self._place >= len(self._stages):
            return False
        return self.deadline_ns is None or not self._stages[self._place].timed

    # What comes in --------------------------------------------------------------------------------

    def hear(self, port: Port[Message], message: Message, time_ns: int) -> None:
        """Take in a message that came at a time of the run's clock."""
        if message.source != port.publisher:
            self._drop("foreign", port, message, f"is from {message.source!r}")
            return
        if isinstance(message, Run):
            self._heed(port, message, time_ns)
            return
        heard = self._inputs.get(port)
        if heard is None or message.cycle < 0 <= self.cycle:  # What is left of arming rounds.
            return
        if port in self._signs and not self.silent:
            if message.incarnation <= self.incarnation:
                return
            self.silent = True
            log.info("falls silent: its standby has taken over in cycle %d", message.incarnation)
        if message.incarnation < heard.incarnation:
            why = f"is of a process that joined in cycle {message.incarnation}, since replaced"
            self._drop("replaced", port, message, why)
            return
        heard.incarnation = message.incarnation
        if port is self._dispatch:
            self._follow_dispatch(message, time_ns)
        if message.cycle > self.cycle:
            self._keep_ahead(heard, message)
        else:
            self._take(heard, message, time_ns)

    def _follow_dispatch(self, dispatch: Message, time_ns: int) -> None:
        """Go where the plant is: to another round, into a run under way, or on with this one."""
        if self.cycle < 0 and dispatch.cycle > self.cycle:
            if dispatch.cycle < 0:
                self.enter(dispatch.cycle, time_ns)
            elif dispatch.cycle > 0:
                self._join(dispatch, time_ns)
        if self.end_cycle <= dispatch.cycle < self._plan.cycles:
            self._go_on_after_false_stop(dispatch, time_ns)

    def _take(self, heard: _Input, message: Message, time_ns: int) -> None:
        """Make a message the newest of its input."""
        port, cycle = heard.port, message.cycle
        if cycle <= heard.heard:
            cause = "duplicate" if cycle == heard.heard else "late"
            self._drop(cause, port, message, f"came after that of cycle {heard.heard}")
            return
        if cycle >= 0 and cycle % heard.period:
            self._drop("unexpected", port, message, "is not of a turn of its sender")
            return
        heard.heard = cycle
        if is_within(message, heard.bounds):
            heard.newest = message
        else:
            self._drop("absurd", port, message, "has a number that cannot be")
        if cycle == self.cycle and port in self.waiting:
            self.waiting.discard(port)
            if not self.waiting:
                self._ready_ns = time_ns

    def _keep_ahead(self, heard: _Input, message: Message) -> None:
        """Keep a message of a cycle to come, one of each cycle."""
        cycle, horizon = message.cycle, self._horizon
        if len(heard.ahead) > horizon or cycle > max(self.cycle, 0) + horizon:
            self._drop("other_cycle", heard.port, message, f"is too far from {self.cycle}")
        elif cycle in heard.ahead:
            self._drop("duplicate", heard.port, message, "came twice")
        else:
            heard.ahead[cycle] = message

    def _heed(self, port: Port[Message], run: Run, time_ns: int) -> None:
        if run.state == "stop":
            if run.cycle <= self._inputs[self._dispatch].heard:
                self._drop("contradicted", port, run, "ends a cycle that the plant has begun")
                return
            self.end_before(run.cycle)
            self.stop_heard = True
        elif self.cycle < 0:
            start_ns = run.start_time_ns
            if not self._plan.lockstep and abs(start_ns - time_ns) > START_WITHIN_NS:
                log.warning("the run begins now, not at %d: that is another clock", start_ns)
                start_ns = time_ns
            self.begin(start_ns, time_ns)

    def _go_on_after_false_stop(self, dispatch: Message, now_ns: int) -> None:
        """Go on with the run: the plant has begun a cycle that a stop said would not take place."""
        why = f"stopped the run before cycle {self.end_cycle}, which the plant has begun"
        self._drop("contradicted", RUN.of(ROOT), dispatch, why)
        was_finished = self.finished
        self.end_cycle = self._plan.cycles
        self.stop_heard = False
        if was_finished:
            self._go_to(self.cycle, now_ns)

    def use_instead(self, port: Port[Message], message: Message) -> None:
        self._inputs[port].newest = message

    def twin(self) -> Self:
        twin = copy(self)
        twin.waiting = self.waiting.copy()
        twin.dropped = self.dropped.copy()
        twin._inputs = {port: copy(heard) for port, heard in self._inputs.items()}
        for heard in twin._inputs.values():
            heard.ahead = heard.ahead.copy()
        return twin

    # Cycles ---------------------------------------------------------------------------------------

    def begin(self, start_ns: int, now_ns: int, cycle: int = 0) -> None:
        """Enter the first cycle of a run; cycle 0 begins at a time of the run's clock."""
        if not self._plan.lockstep:
            self._start_ns = start_ns
        self.incarnation = cycle
        self.enter(cycle, now_ns)

    def _join(self, dispatch: Message, now_ns: int) -> None:
        """Join a run that is under way: the dispatch says in which cycle it is, and since when."""
        began_ns = now_ns
        if abs(dispatch.ready_time_ns - now_ns) <= START_WITHIN_NS:
            began_ns = dispatch.ready_time_ns
        log.info("joined the run in cycle %d", dispatch.cycle)
        self.silent = bool(self._signs)  # Its agent's other process lives, or it will take over.
        self.begin(began_ns - dispatch.cycle * self._plan.cycle_wall_ns, now_ns, dispatch.cycle)

    def end_before(self, cycle: int) -> None:
        """Let the run end before a cycle: those up to it are still completed."""
        self.end_cycle = min(self.end_cycle, cycle)
        if self.finished:
            self._stages, self.waiting, self.deadline_ns = (), set(), None

    def enter(self, cycle: int, now_ns: int) -> None:
        """Enter an arming round or cycle 0, from the initial state."""
        self._state = self.agent.initial_state()
        for heard in self._inputs.values():
            kept = {of: message for of, message in heard.ahead.items() if of >= cycle}
            heard.forget()
            heard.ahead = kept
        self._go_to(cycle, now_ns)

    def catch_up(self, now_ns: int) -> bool:
        """Go to the cycle under way if the agent's own is over; return whether it was."""
        if self._start_ns is None or self.finished or not self.agent.may_skip:
            return False
        under_way = min((now_ns - self._start_ns) // self._plan.cycle_wall_ns, self.end_cycle)
        if under_way <= self.cycle:
            return False
        self.skipped_cycles += under_way - self.cycle
        self._go_to(under_way, now_ns)
        return True

    def _go_to(self, cycle: int, now_ns: int) -> None:
        self.cycle = cycle
        self._place = 0
        self._stages = () if self.finished else self.agent.stages(cycle)
        for heard in self._inputs.values():
            if heard.ahead:
                for due in sorted(of for of in heard.ahead if of <= cycle):
                    self._take(heard, heard.ahead.pop(due), now_ns)
        self._open_stage(now_ns)

    def _open_stage(self, now_ns: int) -> None:
        self.waiting = set()
        self.deadline_ns = None
        self._ready_ns = now_ns
        if self._place < len(self._stages):
            stage, inputs, cycle = self._stages[self._place], self._inputs, self.cycle
            awaits = (*stage.awaits, *self._sign_of(stage)) if self.silent else stage.awaits
            self.waiting = {port for port in awaits if inputs[port].heard != cycle}
            if cycle >= 0 and self._start_ns is not None:
                begin_ns = self._start_ns + cycle * self._plan.cycle_wall_ns
                self.deadline_ns = begin_ns + self._deadline_after_ns(stage.name)
                if self.silent:
                    room_ns = self._plan.deadlines.room_ns(self.agent.name, stage.name)
                    self.deadline_ns += round(self._waits * room_ns)

    def _sign_of(self, stage: Stage) -> tuple[Port[Message], ...]:
        """Return the last port that the agent's other process publishes on in a stage."""
        signs = [
            port
            for port in self._signs
            if stage_of(port, self._plan.tree) == stage.name
            and (self.cycle < 0 or self.cycle % self._inputs[port].period == 0)
        ]
        return tuple(signs[-1:])

    def close_stage(self, now_ns: int) -> list[Delivery]:
        """Close the open stage with what there is; return what the agent sends."""
        stage = self._stages[self._place]
        takes_over = self._may_take_over(stage, now_ns)
        if self.waiting or stage.timed:
            deadline_ns = self.deadline_ns
            self._ready_ns = now_ns if deadline_ns is None else deadline_ns
            self.missing_inputs += len(self.waiting.difference(self._signs))
        inputs, missing = self._inputs_of(stage)
        cycle, sim_time_ns = self.cycle, self._plan.sim_time_ns(self.cycle)
        stamp = (cycle, sim_time_ns, self.agent.name, missing)
        turn = Turn(stage.name, cycle, sim_time_ns, stamp, inputs)
        before = self._state
        self._state, outputs = self.agent.step(before, turn)
        if takes_over and outputs:
            outputs = [self._take_over(before, turn), *outputs]
        elif self.silent:
            outputs = []
        for _, message in outputs:
            message.ready_time_ns = self._ready_ns
            message.incarnation = self.incarnation
        self._place += 1
        if self._place < len(self._stages):
            self._open_stage(now_ns)
        elif cycle >= 0:
            self._go_to(cycle + 1, now_ns)
        return outputs

    # Taking over ----------------------------------------------------------------------------------

    def _may_take_over(self, stage: Stage, now_ns: int) -> bool:
        """Whether the agent's other process has missed its deadline.

        A process that comes late to a deadline itself knows nothing of the other one. One that has
        just joined leaves the standby a cycle to speak first: both would be of one incarnation.
        """
        if not self.silent or self.deadline_ns is None or self.waiting.isdisjoint(self._signs):
            return False
        if self.incarnation and self.cycle <= self.incarnation + 1:
            return False
        newest = max(self._inputs[port].incarnation for port in self._signs)
        slice_ns = self._plan.deadlines.slice_ns(self.agent.name, stage.name)
        return self.cycle > newest and now_ns <= self.deadline_ns + self._waits * slice_ns

    def _take_over(self, state: S, turn: Turn) -> Delivery:
        """Speak from now on; return the message that says so, with what it knows."""
        log.info("takes over in cycle %d", turn.cycle)
        self.silent, self.incarnation = False, turn.cycle
        known = msgspec.structs.asdict(state) if isinstance(state, msgspec.Struct) else {}
        port = TAKEOVER.of("" if self.agent.name == CENTRAL else self.agent.name)
        return port, Takeover(*turn.stamp, stage=turn.stage, **known)

    def resume(self, takeover: Takeover) -> None:
        """Go on with the state of a process that took over."""
        if isinstance(self._state, msgspec.Struct):
            self._state = msgspec.convert(takeover, type(self._state), from_attributes=True)

    def _inputs_of(
        self, stage: Stage
    ) -> tuple[dict[Port[Message], Message | None], tuple[str, ...]]:
        """Return the messages that a stage decides on, and its outputs' `missing`."""
        cycle = self.cycle
        found: dict[Port[Message], Message | None] = {}
        missing: list[str] = []
        for port in chain(stage.awaits, stage.uses):
            heard = self._inputs[port]
            message = heard.newest
            if message is not None and message.cycle != cycle:
                # Cycles since a newer message was due.
                age = cycle - message.cycle - heard.period + 1
                if age > self._plan.hold_cycles:
                    message = None
                elif age > 0:
                    self.old_inputs += 1
                    missing.append(str(Missing(str(port), message.cycle)))
            if message is None:
                missing.append(str(port))
            found[port] = message
        return found, tuple(missing)

    def _drop(self, cause: str, port: Port[Message], message: Message, why: str) -> None:
        if self.cycle >= 0 or cause in _COUNT_IN_ARMING:
            self.dropped[str(port), cause] += 1
            count = self.dropped[str(port), cause]
            self._on_drop(count, f"{port} of cycle {message.cycle} {why}")
