"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins from the initial state, or, if it was a standby, from the state in its `takeover`.
A killed process may have sent a part of its last messages. In the cycle in which it was replaced
both processes may have published: outputs that do not follow from the message that the recorder
heard first are not compared.

Messages that are missing because the recorder was away are no difference, nor are those that a
killed process sent to others but not to the recorder. What an agent remembers is unknown after
that. Compared again is then only what follows from recorded messages, see `_is_known`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, inf
from typing import Any, TypeAlias

import msgspec
from msgspec.structs import replace as replaced

from agents.agent import Agent, Stage, Turn
from agents.control.impp import Estimate
from agents.cycle import stage_of
from agents.direct import DirectController, DirectState
from agents.inputs import Inputs
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Impp, Message, Telemetry, parse_missing
from bus_schemas.signals import DISPATCH, IMPP, ORDER, Port
from bus_schemas.tree import PLANT, ROOT
from recordings.verify.comparison import AgentResult, Difference, Equality
from recordings.verify.recorded_cycles import RecordedCycles
from sim_plant.orders import order_given

Messages: TypeAlias = Mapping[Port[Message], Message]
Outputs: TypeAlias = dict[str, dict[Port[Message], Message]]
"""By stage, the messages that a process published in one cycle."""


class StatedEstimates(DirectController):
    """A direct controller that may be told its estimate.

    stated: What was published of the estimate in this cycle, where nothing else tells it: the
        controller's memory is unknown, or it is a device, which may estimate its maximum as it
        likes, see docs/wire.md.
    """

    stated: Impp | None = None

    def _estimate_now(self, telemetry: Telemetry | None, last: Estimate) -> Estimate:
        stated = self.stated
        if stated is None:
            return super()._estimate_now(telemetry, last)
        is_lost = stated.stale_cycles > self._control.hold_cycles
        return Estimate(last.power_kw if is_lost else stated.power_kw, stated.stale_cycles)


@dataclass
class Process:
    """A process of an agent, that is, one incarnation.

    joined_in: Cycle in which it took over as standby, maybe after the first stage; -1: no standby.
    unknown_since: Cycle since which its memory is unknown; None: it is known.
    sequences: Number of the next message of each port, and the cycle of the last recorded one.
    doubtful: Inputs whose newest message may be another than the recorded one.
    """

    agent: Agent[Any]
    inputs: Inputs
    incarnation: int
    state: Any
    joined_in: int = -1
    unknown_since: int | None = None
    sequences: dict[Port[Message], tuple[int, int]] = field(default_factory=dict)
    doubtful: set[Port[Message]] = field(default_factory=set)

    def lose_track(self, cycle: int) -> None:
        """Note that it used or sent a message that is not known."""
        if self.agent.initial_state() is not None:
            self.unknown_since = cycle


@dataclass
class CycleUnderWay:
    """One cycle of one process.

    recorded: What it published; what has been compared is removed.
    is_last: Whether no newer process published anything in this cycle.
    used: The messages that the agent has used so far.
    is_doubtful: Whether it may have used a message other than the recorded one.
    stage: The stage under way.
    """

    cycle: int
    recorded: Outputs
    is_last: bool
    used: dict[Port[Message], Message] = field(default_factory=dict)
    is_doubtful: bool = False
    stage: str = ""


class AgentRerun:
    """Takes one agent, made from the present code, through a recording, from `from_cycle` on."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        plan: RunPlan,
        recorded: RecordedCycles,
        equality: Equality,
        from_cycle: int,
    ) -> None:
        self.result = AgentResult(from_cycle=from_cycle)
        self._name = name
        self._make = make
        self._plan = plan
        self._recorded = recorded
        is_device = name in plan.access.external
        if is_device:  # It may leave `missing` empty.
            equality = replace(equality, ignored=equality.ignored | {"missing"})
        self._equality = equality
        self._estimates_as_it_likes = is_device and plan.control.scheme != "paper"
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.published[name]
            if port.signal.logged and port.signal.decided
        }
        self._processes: dict[int, Process] = {}
        self._newest_incarnation = 0

    def take(self, cycle: int) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        outputs = self._outputs(cycle)
        for incarnation, recorded in sorted(outputs.items()):
            if self.result.failure is not None:
                break
            self._newest_incarnation = incarnation
            now = CycleUnderWay(cycle, recorded, incarnation == max(outputs))
            try:
                self._run(incarnation, now)
            except (Exception, SystemExit) as error:  # Any error of the tested code is a result.
                text = f"{type(error).__name__}: {error}"
                used = {str(port): message for port, message in now.used.items()}
                self.result.add(Difference("fails", cycle, now.stage, inputs=used, text=text))
        if cycle >= self.result.from_cycle:
            left = (messages for one in outputs.values() for messages in one.values())
            self.result.not_compared += sum(map(len, left))

    def _outputs(self, cycle: int) -> dict[int, Outputs]:
        """Return what each process of the agent published in a cycle.

        If none published anything, the newest one is there.
        """
        outputs: dict[int, Outputs] = {}
        is_compared = cycle >= self.result.from_cycle
        for port, stage in self._stage_of.items():
            for message in self._recorded.on(port, cycle):
                self.result.recorded += is_compared
                messages = outputs.setdefault(message.incarnation, {}).setdefault(stage, {})
                is_second = messages.setdefault(port, message) is not message
                # A process killed in its first cycle has a successor of the same incarnation.
                if is_second and is_compared and not 0 < cycle == message.incarnation:
                    twice = Difference("sent twice", cycle, stage, str(port), content=message)
                    self.result.add(twice)
        return outputs or {self._newest_incarnation: {}}

    def _begin(self, incarnation: int) -> Process:
        agent = self._make()
        inputs = Inputs(self._plan, agent.name, 0, lambda count, why: None)
        process = Process(agent, inputs, incarnation, agent.initial_state())
        takeover = self._recorded.takeovers.get((self._name, incarnation))
        if takeover is not None:
            process.joined_in = incarnation
            if process.state is not None:
                kind = type(process.state)
                process.state = msgspec.convert(takeover, kind, from_attributes=True)
        elif incarnation and self._recorded.was_away(self._name, incarnation):
            process.lose_track(incarnation)  # The recorder may have missed a takeover.
        return process

    def _run(self, incarnation: int, now: CycleUnderWay) -> None:
        if incarnation not in self._processes:
            self._processes[incarnation] = self._begin(incarnation)
        process = self._processes[incarnation]
        if not self._plan.timing.lockstep:
            self._find_lost_outputs(process, now)
        stages = list(process.agent.stages(now.cycle))
        unknown = now.recorded.keys() - {stage.name for stage in stages}
        if not (self._plan.timing.lockstep and now.is_last):
            while stages and stages[-1].name not in now.recorded:
                stages.pop()
        if now.cycle == process.joined_in:  # Before it took over, a standby published nothing.
            stages = [stage for stage in stages if stage.name in now.recorded]
        for stage in stages:
            self._run_stage(process, now, stage)
        for name in unknown:
            now.stage = name
            self._compare(process, now, {})

    def _run_stage(self, process: Process, now: CycleUnderWay, stage: Stage) -> None:
        now.stage, cycle, agent = stage.name, now.cycle, process.agent
        recorded = now.recorded.get(stage.name, {})
        is_certain = self._take_inputs(process, now, stage)
        if isinstance(agent, StatedEstimates) and stage.name == "estimate":
            is_told = self._estimates_as_it_likes or process.unknown_since is not None
            said = recorded.get(IMPP.of(self._name))
            agent.stated = said if is_told and isinstance(said, Impp) else None
        is_known = self._is_known(process, now)
        used, missing = process.inputs.used(stage, cycle)
        dispatch = recorded.get(DISPATCH.of(ROOT))
        if isinstance(dispatch, Dispatch):
            used[ORDER.of(ROOT)] = order_given(dispatch)
        sim_time_ns = self._plan.timing.sim_time_ns(cycle)
        stamp = (cycle, sim_time_ns, agent.name, missing, 0, 0, 0, process.incarnation)
        turn = Turn(stage.name, cycle, sim_time_ns, stamp, used)
        before = process.state
        process.state, outputs = agent.step(before, turn)
        if process.unknown_since is not None or self._estimates_as_it_likes:
            is_known &= self._is_same_whatever_it_remembers(agent, before, turn, outputs)
        if process.unknown_since is not None:
            self._learn(process, now, dispatch)
        new = dict(outputs)
        if not is_certain or (process.unknown_since is not None and missing):
            process.lose_track(cycle)
        elif not recorded and not self._plan.timing.lockstep:
            if is_known and not self._recorded.was_away(self._name, cycle):
                self.result.add(Difference("not recorded", cycle, stage.name))
            process.lose_track(cycle)
        elif now.is_doubtful and not self._are_equal(recorded, new):
            process.lose_track(cycle)
        elif is_known:
            self._compare(process, now, new)

    def _is_known(self, process: Process, now: CycleUnderWay) -> bool:
        """Whether a stage's outputs follow from recorded messages.

        The plant forgets what it was commanded before its slowest inverter has followed. A direct
        controller commands by the IMPP that it has just published.
        """
        since, agent = process.unknown_since, process.agent
        if since is not None and self._name == PLANT:
            timing, site = self._plan.timing, self._plan.site
            slowest_s = max(map(site.follows_within_s, self._plan.tree.leaves))
            if now.cycle - since > ceil(slowest_s / timing.cycle_s) + 2:
                process.unknown_since = None
        elif since is not None and isinstance(agent, StatedEstimates) and now.stage == "actuate":
            # Of an inverter that is lost it says 0 kW, and remembers what it was.
            stated, hold = agent.stated, self._plan.control.hold_cycles
            return stated is not None and stated.stale_cycles <= hold
        return process.unknown_since is None

    def _is_same_whatever_it_remembers(
        self, agent: Agent[Any], state: object, turn: Turn, outputs: Sequence[Delivery]
    ) -> bool:
        """Whether a command does not depend on the mean forecast error, which is not published."""
        return not (isinstance(state, DirectState) and turn.stage == "actuate") or all(
            agent.step(replaced(state, estimate=state.estimate._replace(spread_kw=kw)), turn)[1]
            == outputs
            for kw in (0.0, inf)
        )

    def _learn(self, process: Process, now: CycleUnderWay, dispatch: Message | None) -> None:
        """Take from what was published what a process of unknown memory remembers since then."""
        if isinstance(dispatch, Dispatch):
            process.state = replace(process.state, dispatch=dispatch)
        elif isinstance(process.state, DirectState):
            process.state = replaced(process.state, telemetry_cycle=now.cycle)

    def _take_inputs(self, process: Process, now: CycleUnderWay, stage: Stage) -> bool:
        """Take in the messages that a stage used; return whether all of them are recorded."""
        outputs = now.recorded.get(stage.name, {})
        if not outputs and not self._plan.timing.lockstep:
            return True  # It is unknown what it used.
        used_of = dict(map(parse_missing, next(iter(outputs.values())).missing if outputs else ()))
        are_recorded = True
        for port in (*stage.awaits, *stage.uses):
            if port.signal is ORDER:
                continue  # The dispatch says which order it followed.
            one = process.inputs.of[port]
            used = used_of.get(str(port), now.cycle - now.cycle % one.period)
            if used is None or used <= one.newest_cycle:
                now.is_doubtful |= used == one.newest_cycle and port in process.doubtful
                continue
            messages = self._recorded.on(port, used)
            if not messages:
                if not self._recorded.may_lack(port.publisher, used):
                    lost = Difference("input not recorded", now.cycle, stage.name, str(port))
                    self.result.add(lost)
                are_recorded = False
                continue
            process.doubtful.discard(port)
            if self._may_be_another(port, messages):
                process.doubtful.add(port)
                now.is_doubtful = True
            process.inputs.take(one, messages[0], now.cycle)
            now.used[port] = messages[0]
        return are_recorded

    def _may_be_another(self, port: Port[Message], messages: Sequence[Message]) -> bool:
        """Whether the agent may have used another message of a port and cycle than the first one.

        Several may be recorded. If not, a process and its successor may both have published one. In
        real time, without a standby, they cannot: the successor joins with a dispatch that was sent
        after the other one ended.
        """
        first, *others = messages
        joined = 0 < first.cycle == first.incarnation
        may_overlap = self._plan.timing.lockstep or port.publisher in self._plan.standbys
        return bool(others) or (joined and may_overlap)

    def _are_equal(self, recorded: Messages, new: Messages) -> bool:
        return recorded.keys() == new.keys() and not any(
            self._equality.differences(port, recorded[port], new[port]) for port in new
        )

    def _compare(self, process: Process, now: CycleUnderWay, outputs: Messages) -> None:
        """Compare the outputs of the stage under way; remove what has been compared."""
        recorded = now.recorded.get(now.stage, {})
        for port, new in outputs.items():
            old = recorded.pop(port, None)
            if old is None:  # If the recording lost it, its number is known to be missing.
                sequence, cycle = process.sequences.get(port, (0, process.incarnation))
                process.sequences[port] = sequence + 1, cycle
                if self._recorded.may_lack(self._name, new.cycle):
                    continue
            self.result.compare(self._equality, port, old, new, now.stage, now.used)
        for port, old in recorded.items():
            self.result.compare(self._equality, port, old, None, now.stage, now.used)
        recorded.clear()

    def _find_lost_outputs(self, process: Process, now: CycleUnderWay) -> None:
        """Find gaps in the sequence numbers: the recording lost messages there."""
        outputs = [(stage, *pair) for stage, of in now.recorded.items() for pair in of.items()]
        for stage, port, message in outputs:
            expected, since = process.sequences.get(port, (0, message.incarnation))
            if message.sequence > expected:
                was_known = process.unknown_since is None
                if was_known and not self._recorded.was_away(self._name, since, now.cycle):
                    lost = Difference("not recorded", now.cycle, stage, str(port), content=message)
                    self.result.add(lost)
                process.lose_track(now.cycle)
            process.sequences[port] = message.sequence + 1, now.cycle
