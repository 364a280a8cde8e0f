"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins from the initial state.

An agent is compared up to the first message that it used or sent and that is not recorded: what it
remembers after that is unknown. Its next process begins anew and is compared again, and an agent
that remembers nothing goes on at once. Such a gap is a difference, unless the recorder was away or
a process was killed as it sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, TypeAlias

from msgspec.structs import replace as replaced

from agents.agent import Agent, Stage, Turn
from agents.control.impp import Estimate
from agents.cycle import stage_of
from agents.direct import DirectController, DirectState
from agents.inputs import Inputs
from agents.plan import RunPlan
from bus_schemas.messages import Command, Dispatch, Impp, Message, Telemetry, parse_missing
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, ORDER, Port
from bus_schemas.tree import ROOT
from recordings.record.plausibility import out_of_range
from recordings.verify.comparison import AgentResult, Difference, Equality, Gap
from recordings.verify.recorded_cycles import RecordedCycles
from sim_plant.orders import orders_given

Messages: TypeAlias = Mapping[Port[Message], Message]
Outputs: TypeAlias = dict[str, dict[Port[Message], Message]]
"""By stage, the messages that a process published in one cycle."""


class DeviceController(DirectController):
    """A direct controller with the estimate that a device states: it may have one of its own.

    stated: What the device published of its estimate in this cycle; None: ours is used.
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

    sequences: Number of the next message of each port, and the cycle of the last recorded one.
    gap: From where on it cannot be compared; None: it can.
    """

    agent: Agent[Any]
    inputs: Inputs
    incarnation: int
    state: Any
    sequences: dict[Port[Message], tuple[int, int]] = field(default_factory=dict)
    gap: Gap | None = None


@dataclass
class CycleUnderWay:
    """One cycle of one process.

    recorded: What it published; what has been compared is removed.
    is_last: Whether no newer process published anything in this cycle.
    used: The messages that the agent has used so far.
    ambiguous: An input of which it may have used a message other than the first recorded one.
    stage: The stage under way.
    """

    cycle: int
    recorded: Outputs
    is_last: bool
    used: dict[Port[Message], Message] = field(default_factory=dict)
    ambiguous: Port[Message] | None = None
    stage: str = ""


class AgentRerun:
    """Takes one agent, made from the present code, through a recording."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        plan: RunPlan,
        recorded: RecordedCycles,
        equality: Equality,
    ) -> None:
        self.result = AgentResult()
        self._name = name
        self._make = make
        self._plan = plan
        self._recorded = recorded
        self._is_device = name in plan.access.external
        if self._is_device:  # It may leave `missing` empty.
            equality = replace(equality, ignored=equality.ignored | {"missing"})
        self._equality = equality
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.ports
            if port.publisher == name and port.signal.logged and port.signal.decided
        }
        self._processes: dict[int, Process] = {}
        self._newest = 0

    def take(self, cycle: int) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        outputs = self._outputs(cycle)
        for incarnation, recorded in sorted(outputs.items()):
            if self.result.failure is not None:
                break
            now = CycleUnderWay(cycle, recorded, incarnation == max(outputs))
            try:
                process = self._process_of(incarnation, cycle)
                if process.gap is None:
                    self._run(process, now)
            except (Exception, SystemExit) as error:  # Any error of the tested code is a result.
                text = f"{type(error).__name__}: {error}"
                used = {str(port): message for port, message in now.used.items()}
                self.result.add(Difference("fails", cycle, now.stage, inputs=used, text=text))

    def _outputs(self, cycle: int) -> dict[int, Outputs]:
        """Return what each process of the agent published in a cycle.

        If none published anything, the newest one is there.
        """
        outputs: dict[int, Outputs] = {}
        for port, stage in self._stage_of.items():
            for message in self._recorded.on(port, cycle):
                self.result.recorded += 1
                messages = outputs.setdefault(message.incarnation, {}).setdefault(stage, {})
                first = messages.setdefault(port, message)
                if first is message:
                    continue
                # A process killed in its first cycle has a successor of the same incarnation.
                if 0 < cycle == message.incarnation and first == message:
                    self.result.compared += 1
                    continue
                twice = Difference("sent twice", cycle, stage, str(port), content=message)
                self.result.add(twice)
        return outputs or {self._newest: {}}

    def _process_of(self, incarnation: int, cycle: int) -> Process:
        """Return the process of an incarnation; a new one begins anew."""
        if (known := self._processes.get(incarnation)) is not None:
            return known
        agent = self._make()
        inputs = Inputs(self._plan, agent.name, 0, lambda count, why: None)
        process = Process(agent, inputs, incarnation, agent.initial_state())
        before = self._processes.get(self._newest)
        if before is not None and before.gap is not None:
            before.gap.until = cycle
        self._processes[incarnation], self._newest = process, incarnation
        if incarnation and self._recorded.was_away(self._name, incarnation):
            self._lose(process, cycle, "its first messages are not recorded")
        return process

    def _lose(self, process: Process, cycle: int, why: str) -> None:
        """Note that a process used or sent an unknown message."""
        gap = Gap(cycle, None, why)
        if process.agent.initial_state() is None:
            gap.until = cycle + 1  # It remembers nothing.
        else:
            process.gap = gap
        self.result.gaps.append(gap)

    def _run(self, process: Process, now: CycleUnderWay) -> None:
        lockstep = self._plan.timing.lockstep
        if not lockstep and self._has_lost_outputs(process, now):
            self._lose(process, now.cycle, "messages of its own are not recorded")
        stages = list(process.agent.stages(now.cycle))
        unknown = now.recorded.keys() - {stage.name for stage in stages}
        if not (lockstep and now.is_last):
            while stages and stages[-1].name not in now.recorded:
                stages.pop()
        for stage in stages:
            if process.gap is not None:
                return
            self._run_stage(process, now, stage)
        for name in unknown:
            now.stage = name
            self._compare(process, now, {})

    def _run_stage(self, process: Process, now: CycleUnderWay, stage: Stage) -> None:
        now.stage, cycle, agent = stage.name, now.cycle, process.agent
        recorded = now.recorded.get(stage.name, {})
        if not recorded and not self._plan.timing.lockstep:  # It is unknown what it used.
            if not self._recorded.was_away(self._name, cycle):
                self.result.add(Difference("not recorded", cycle, stage.name))
            self._lose(process, cycle, f"what it sent in stage {stage.name} is not recorded")
            return
        lacking = self._take_inputs(process, now, stage)
        if lacking is not None:
            self._lose(process, cycle, f"{lacking} is not recorded")
            return
        if isinstance(agent, DeviceController) and stage.name == "estimate":
            agent.stated = self._stated(recorded, cycle)
        used, missing = process.inputs.used(stage, cycle)
        dispatch = recorded.get(DISPATCH.of(ROOT))
        if isinstance(dispatch, Dispatch):
            used[ORDER.of(ROOT)] = orders_given(dispatch)
        sim_time_ns = self._plan.timing.sim_time_ns(cycle)
        stamp = (cycle, sim_time_ns, agent.name, missing, 0, 0, 0, process.incarnation)
        turn = Turn(stage.name, cycle, sim_time_ns, stamp, used)
        before = process.state
        process.state, outputs = agent.step(before, turn)
        new = dict(outputs)
        if isinstance(agent, DeviceController) and agent.stated is not None:
            self._allow_other_margins(agent, before, turn, new, recorded)
        if now.ambiguous is not None and not self._are_equal(recorded, new):
            self._lose(process, cycle, f"two messages of {now.ambiguous} came in one cycle")
        else:
            self._compare(process, now, new)

    def _stated(self, recorded: Messages, cycle: int) -> Impp | None:
        """Return the estimate that a device states, if a listener accepts it."""
        port = IMPP.of(self._name)
        said = recorded.get(port)
        is_sound = isinstance(said, Impp) and not out_of_range(self._plan, port, said, 0)
        return said if is_sound and isinstance(said, Impp) else None

    def _allow_other_margins(
        self,
        agent: DeviceController,
        before: DirectState,
        turn: Turn,
        new: dict[Port[Message], Message],
        recorded: Messages,
    ) -> None:
        """Accept a command between the limits for any forecast error, which is not published."""
        port = COMMAND.of(self._name)
        mine, its = new.get(port), recorded.get(port)
        if not (isinstance(mine, Command) and isinstance(its, Command)):
            return
        limits_kw = []
        for spread_kw in (0.0, inf):
            state = replaced(before, estimate=before.estimate._replace(spread_kw=spread_kw))
            command = dict(agent.step(state, turn)[1])[port]
            limits_kw += [command.power_kw] if isinstance(command, Command) else []
        if min(limits_kw) <= its.power_kw <= max(limits_kw):
            mine.power_kw = its.power_kw

    def _take_inputs(
        self, process: Process, now: CycleUnderWay, stage: Stage
    ) -> Port[Message] | None:
        """Take in the messages that a stage used; return one that is not recorded."""
        outputs, lacking = now.recorded.get(stage.name, {}), None
        used_of = dict(map(parse_missing, next(iter(outputs.values())).missing if outputs else ()))
        for port in (*stage.awaits, *stage.uses):
            if port.signal is ORDER:
                continue  # The dispatch says which order it followed.
            one = process.inputs.of[port]
            used = used_of.get(str(port), now.cycle - now.cycle % one.period)
            if used is None or used <= one.newest_cycle:
                continue
            messages = self._recorded.on(port, used)
            if not messages:
                if not self._recorded.may_lack(port.publisher, used):
                    lost = Difference("input not recorded", now.cycle, stage.name, str(port))
                    self.result.add(lost)
                lacking = port
                continue
            if self._may_be_another(messages):
                now.ambiguous = port
            process.inputs.take(one, messages[0], now.cycle)
            now.used[port] = messages[0]
        return lacking

    def _may_be_another(self, messages: Sequence[Message]) -> bool:
        """Whether the agent may have used another message of a port and cycle than the first one.

        Several may be recorded. In lockstep, a process that is killed and its successor may both
        have published one; in real time the successor joins with a later dispatch.
        """
        first, *others = messages
        joined = 0 < first.cycle == first.incarnation
        return bool(others) or (joined and self._plan.timing.lockstep)

    def _are_equal(self, recorded: Messages, new: Messages) -> bool:
        return recorded.keys() == new.keys() and not any(
            self._equality.differences(port, recorded[port], new[port]) for port in new
        )

    def _compare(self, process: Process, now: CycleUnderWay, outputs: Messages) -> None:
        """Compare the outputs of the stage under way; remove those compared."""
        recorded = now.recorded.get(now.stage, {})
        for port, new in outputs.items():
            old = recorded.pop(port, None)
            if old is None:  # If the recording lost it, its number is known to be missing.
                sequence, cycle = process.sequences.get(port, (0, process.incarnation))
                process.sequences[port] = sequence + 1, cycle
                if self._recorded.may_lack(self._name, new.cycle):
                    continue
            self._compare_one(port, old, new, now)
        for port, old in recorded.items():
            self._compare_one(port, old, None, now)
        recorded.clear()

    def _compare_one(
        self, port: Port[Message], old: Message | None, new: Message | None, now: CycleUnderWay
    ) -> None:
        refused = out_of_range(self._plan, port, old, 0) if self._is_device and old else ""
        self.result.compare(self._equality, port, old, new, now.stage, now.used, refused)

    def _has_lost_outputs(self, process: Process, now: CycleUnderWay) -> bool:
        """Whether the sequence numbers have a gap: the recording lost messages."""
        is_lost = False
        outputs = [(stage, *pair) for stage, of in now.recorded.items() for pair in of.items()]
        for stage, port, message in outputs:
            expected, since = process.sequences.get(port, (0, message.incarnation))
            if message.sequence > expected:
                is_lost = True
                if not self._recorded.was_away(self._name, since, now.cycle):
                    lost = Difference("not recorded", now.cycle, stage, str(port), content=message)
                    self.result.add(lost)
            process.sequences[port] = message.sequence + 1, now.cycle
        return is_lost
