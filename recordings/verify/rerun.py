"""One agent re-run on the inputs that it used, and what it publishes compared with the recording.

Its recorded outputs tell which inputs those were: `missing` names those that were not the ones that
were due, and it had everything else. So a run in real time is re-run as exactly as one in lockstep:
the clock jumps from deadline to deadline, and nothing arrives but what was used.

In lockstep every stage of every cycle was run. In real time an agent may skip cycles: a stage of
which no output is recorded was not run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace as with_stages
from typing import Any, Final, TypeAlias, TypeVar

from msgspec.structs import replace

from agents.agent import Agent, Stage, Turn
from agents.cycle import stage_of
from agents.driver import Driver
from agents.loop import AgentLoop
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.memory_bus import VirtualClock
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.verify.account import Account, Difference, Kind
from recordings.verify.comparison import Comparison, Unsendable
from recordings.verify.recorded_cycles import CycleWalk, RecordedCycle
from recordings.verify.recording_bus import RecentMessages, RecordingBus

_CYCLE_NS: Final = 1_000_000_000
"""Length of a cycle on the clock of a re-run: any will do."""


T = TypeVar("T")

State: TypeAlias = Any
"""What an agent remembers: its own business."""


class AgentFailure(Exception):  # noqa: N818 - what failed is the agent, not the program
    """The code under test raised an error. The text names it."""


class TestedAgent:
    """An agent whose errors are told from those of the verification.

    Its stages close at their deadlines alone, one at a time.
    """

    def __init__(self, make: Callable[[], Agent[Any]]) -> None:
        self.closed = 0
        self._agent = agent = _guarded(make)
        self.name: str = _guarded(lambda: agent.name)
        self.may_skip: bool = _guarded(lambda: agent.may_skip)
        self.remembers = _guarded(agent.initial_state) is not None
        self._stages: dict[tuple[Stage, ...], tuple[Stage, ...]] = {}

    def initial_state(self) -> State:
        """State before cycle 0."""
        return _guarded(self._agent.initial_state)

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages of a cycle."""
        try:
            own = self._agent.stages(cycle)
        except (Exception, SystemExit) as error:
            raise AgentFailure(f"{type(error).__name__}: {error}") from error
        stages = self._stages.get(own)
        if stages is None:
            stages = tuple(with_stages(stage, timed=True) for stage in own)
            self._stages[own] = stages
        return stages

    def step(self, state: State, turn: Turn) -> tuple[State, list[Delivery]]:
        """Close one stage."""
        self.closed += 1
        try:
            state, outputs = self._agent.step(state, turn)
            if not all(isinstance(message, Message) for _, message in outputs):
                raise TypeError(f"a stage returns {outputs!r}")
        except (Exception, SystemExit) as error:  # Whatever the code under test does is a finding.
            raise AgentFailure(f"{type(error).__name__}: {error}") from error
        return state, outputs


def _guarded(call: Callable[[], T]) -> T:
    try:
        return call()
    except (Exception, SystemExit) as error:
        raise AgentFailure(f"{type(error).__name__}: {error}") from error


def on_a_clock(plan: RunPlan) -> RunPlan:
    """Return the plan of a run with deadlines, also if it was in lockstep."""
    return replace(plan, cycle_wall_ns=_CYCLE_NS, tier_deadlines_ns=())


class AgentRerun:
    """One agent on its way through a recording.

    Parameters
    ----------
    name
        Name of the agent.
    make
        Makes the agent, as the code is now.
    plan, clocked
        Of the recorded run, and the same by the clock of a re-run, see `on_a_clock`.
    walk
        Through the recording.
    recent
        The newest messages of all agents.
    stop_cycle
        The first cycle that did not take place; None: the recording breaks off.
    comparison
        What counts as equal.

    Attributes
    ----------
    account
        What it came to so far.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        plan: RunPlan,
        clocked: RunPlan,
        walk: CycleWalk,
        recent: RecentMessages,
        stop_cycle: int | None,
        comparison: Comparison,
    ) -> None:
        self.name = name
        self.account = Account()
        self._plan = plan
        self._walk = walk
        self._recent = recent
        self._broke_off = stop_cycle is None
        self._comparison = comparison
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.published[name]
            if port.signal.logged and port.signal.decided
        }
        self._numbers: dict[Port[Message], int] = {}
        self._clock = VirtualClock()
        self._bus = RecordingBus(name, plan, recent, self._clock)
        self._given: list[Delivery] = []
        self._lacked: dict[Port[Message], int] = {}
        self._over = False
        try:
            self._agent = TestedAgent(make)
            self._loop = AgentLoop(self._agent, clocked)
            self._driver = Driver([self._loop], self._bus, self._clock)
            self._loop.begin(0, 0)
            self._driver.go_on(self._loop)
        except AgentFailure as failure:
            self._fail(0, "", str(failure))

    def take(self, cycle: RecordedCycle) -> None:
        """Re-run a cycle and compare what the agent publishes in it."""
        recorded: dict[str, dict[Port[Message], Message]] = {}
        count = 0
        for port, stage in self._stage_of.items():
            message = cycle.messages.get(port)
            if message is not None:
                recorded.setdefault(stage, {})[port] = message
                count += 1
        self.account.recorded += count
        for port, message in cycle.repeated:
            if port in self._stage_of:
                self.account.recorded += 1
                self._add("recorded twice", cycle.number, self._stage_of[port], port, message)
        if not self._over:
            self._note_lost(cycle.number, recorded)
        if self._over:
            self.account.leave_out(cycle.number, count)
            return
        try:
            self._run(cycle.number, recorded)
        except AgentFailure as failure:
            left = sum(map(len, recorded.values()))
            self._fail(cycle.number, self._loop.stage, str(failure))
            self.account.leave_out(cycle.number, left)
        self.account.missing_inputs = self._loop.missing_inputs
        self.account.old_inputs = self._loop.old_inputs

    def _runs_all(self, cycle: int) -> bool:
        """Whether each stage of a cycle was run, also one of which nothing is recorded."""
        return self._plan.lockstep and not self._is_cut_off(cycle, self.name)

    def _is_cut_off(self, cycle: int, agent: str) -> bool:
        """Whether the recording breaks off where an agent's messages of a cycle would be."""
        return self._broke_off and cycle >= self._walk.newest[agent]

    def _run(self, cycle: int, recorded: dict[str, dict[Port[Message], Message]]) -> None:
        stages = self._agent.stages(cycle)
        if not self._runs_all(cycle):
            while stages and stages[-1].name not in recorded:
                stages = stages[:-1]
            if not stages:
                return
        self._given = []
        self._clock.now_ns = max(self._clock.now_ns, cycle * _CYCLE_NS)
        for stage in stages:
            self._run_stage(cycle, stage, recorded.pop(stage.name, {}))
            if self._over:
                break
        left = sum(map(len, recorded.values()))
        self.account.leave_out(cycle, left)

    def _run_stage(self, cycle: int, stage: Stage, recorded: dict[Port[Message], Message]) -> None:
        missing = next(iter(recorded.values())).missing if recorded else ()
        given, lacking = self._bus.bring(stage, cycle, missing)
        self._given += given
        closed = self._agent.closed
        try:
            while self._agent.closed == closed:
                self._driver.turn()
            if lacking or not (recorded or self._runs_all(cycle)):
                self._lose_inputs(cycle, stage, lacking)
                self.account.leave_out(cycle, len(recorded))
            else:
                self._compare(cycle, stage, recorded)
        except (AgentFailure, Unsendable) as failure:
            self._fail(cycle, stage.name, str(failure), missing)
            self.account.leave_out(cycle, len(recorded))

    def _compare(self, cycle: int, stage: Stage, recorded: dict[Port[Message], Message]) -> None:
        account, comparison, name = self.account, self._comparison, stage.name
        ambiguous = self._recent.were_repeated((*stage.awaits, *stage.uses))
        for port, new in self._bus.published:
            old = recorded.pop(port, None)
            if old is not None and comparison.are_equal(old, new):
                account.compared += 1
                continue
            if old is None:
                if self._is_cut_off(cycle, self.name):
                    continue
                self._numbers[port] = self._numbers.get(port, 0) + 1
            account.compare(comparison, port, old, new, name, self._given, ambiguous=ambiguous)
        for port, old in recorded.items():
            account.compare(comparison, port, old, None, name, self._given)
        recorded.clear()

    def _note_lost(self, cycle: int, recorded: dict[str, dict[Port[Message], Message]]) -> None:
        """In real time, find messages that the recording lost by their numbers on each key."""
        if self._plan.lockstep:
            return
        for stage, outputs in recorded.items():
            for port, message in outputs.items():
                if message.sequence > self._numbers.get(port, 0):
                    self._add("not recorded", cycle, stage, port, message)
                    self._over = self._agent.remembers
                self._numbers[port] = message.sequence + 1

    def _lose_inputs(self, cycle: int, stage: Stage, lacking: list[Port[Message]]) -> None:
        """Go on without knowing what a stage used: from here on an agent's memory is not known."""
        for port in lacking:
            if self._lacked.get(port) != cycle and not self._is_cut_off(cycle, port.publisher):
                self._lacked[port] = cycle  # Another stage may use it too.
                self._add("input not recorded", cycle, stage.name, port)
        self._over = self._agent.remembers

    def _fail(self, cycle: int, stage: str, text: str, missing: tuple[str, ...] = ()) -> None:
        given = tuple(self._given)
        self.account.add(
            Difference("fails", cycle, stage, None, inputs=given, missing=missing, text=text)
        )
        self._over = True

    def _add(
        self,
        kind: Kind,
        cycle: int,
        stage: str,
        port: Port[Message],
        message: Message | None = None,
    ) -> None:
        inputs = tuple(self._given) if kind == "input not recorded" else ()
        self.account.add(Difference(kind, cycle, stage, port, message=message, inputs=inputs))
