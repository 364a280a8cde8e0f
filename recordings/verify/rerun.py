"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins from the initial state, or, if it was a standby, from the state in its `takeover`.
A killed process may have sent a part of its last messages. In the cycle in which it was replaced
both processes may have published: outputs that do not follow from the message that the recorder
heard first are not compared.

Messages that are missing because the recorder was restarted are no difference, nor are those that a
killed process sent to others but not to the recorder. An agent that remembers earlier cycles is not
compared after that, until another process replaces it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from agents.agent import Agent, Stage
from agents.cycle import stage_of
from agents.driver import Driver
from agents.loop import Loop
from agents.plan import RunPlan
from bus_schemas.bus import Arrival, Delivery
from bus_schemas.memory_bus import VirtualClock
from bus_schemas.messages import Message, parse_missing
from bus_schemas.signals import Port
from recordings.verify.agent_result import AgentResult, Difference, by_key
from recordings.verify.equality import Equality
from recordings.verify.recorded_cycles import RecordedCycles

Messages: TypeAlias = dict[Port[Message], Message]


@dataclass
class Process:
    """A process of an agent, that is, one incarnation; and its bus, which has recorded inputs only.

    stage_of: The stage in which it publishes on each port.
    joined_in: Cycle in which it took over as standby, maybe after the first stage; -1: no standby.
    is_uncertain: Whether its state is unknown from now on, so that nothing more is compared.
    newest_used: Newest cycle of each input.
    sequences: Number of the next message of each port, and the cycle of the last recorded one.
    """

    loop: Loop[Any]
    stage_of: Mapping[Port[Message], str]
    joined_in: int = -1
    is_uncertain: bool = False
    newest_used: dict[Port[Message], int] = field(default_factory=dict)
    sequences: dict[Port[Message], tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._remembers = self.loop.agent.initial_state() is not None
        self._clock = VirtualClock()
        self._driver = Driver([self.loop], self, self._clock)
        self._inputs: list[Arrival] = []
        self._sent: dict[tuple[int, str], list[Delivery]] = {}

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        self._sent.setdefault((message.cycle, self.stage_of[port]), []).append((port, message))

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        arrivals, self._inputs = self._inputs, []
        return arrivals

    def lose_track(self) -> None:
        """Note that it used or sent a message that is not known."""
        self.is_uncertain = self._remembers

    def go_to(self, begin_ns: int) -> None:
        """Go to the cycle that begins at a time, unless it is under way."""
        self._clock.now_ns = max(self._clock.now_ns, begin_ns)
        self._driver.join(self.loop)

    def close(self, cycle: int, stage: str, inputs: Messages) -> None:
        """Close a stage of a cycle on its inputs, and the following ones that await nothing."""
        loop, open_stage = self.loop, (cycle, stage)
        if (loop.cycle, loop.stage) == open_stage:
            # What the stage awaits comes last, since that closes it.
            ports = sorted(inputs, key=loop.waiting.__contains__)
            self._inputs = [Arrival(loop.name, port, inputs[port], 0) for port in ports]
            self._driver.turn()
        if (loop.cycle, loop.stage) == open_stage:  # Nothing else will come: its deadline is now.
            self._clock.now_ns += 1
            loop.deadline_ns = self._clock.now_ns
            self._driver.advance(loop)
            self._driver.turn()

    def sent(self, cycle: int, stage: str) -> list[Delivery]:
        """Return what the agent has published in a stage of a cycle, and forget it."""
        return self._sent.pop((cycle, stage), [])


@dataclass
class CycleUnderWay:
    """One cycle of one process.

    incarnation: The process.
    recorded: What it published, by stage; what has been compared is removed.
    is_last: Whether no newer process published anything in this cycle.
    inputs: The messages that the agent has used so far.
    has_doubtful_inputs: Whether it may have used a message other than the recorded one.
    stage: The stage under way.
    """

    cycle: int
    incarnation: int
    recorded: dict[str, Messages]
    is_last: bool
    inputs: Messages = field(default_factory=dict)
    has_doubtful_inputs: bool = False
    stage: str = ""


@dataclass(eq=False)
class AgentRerun:
    """Takes one agent, made from the present code, through a recording."""

    name: str
    make: Callable[[], Agent[Any]]
    plan: RunPlan
    recorded: RecordedCycles
    equality: Equality
    result: AgentResult

    def __post_init__(self) -> None:
        plan, name = self.plan, self.name
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.published[name]
            if port.signal.logged and port.signal.decided
        }
        self._period = {port: plan.control.period(port) for port in plan.wiring.heard.get(name, ())}
        self._processes: dict[int, Process] = {}
        self._newest_incarnation = 0

    def take(self, cycle: int) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        outputs = self._outputs(cycle)
        for incarnation, recorded in sorted(outputs.items()):
            if self.result.failure is not None:
                break
            self._newest_incarnation = incarnation
            now = CycleUnderWay(cycle, incarnation, recorded, incarnation == max(outputs))
            try:
                self._run(now)
            except (Exception, SystemExit) as error:  # Any error of the tested code is a result.
                text = f"{type(error).__name__}: {error}"
                inputs = by_key(now.inputs)
                self.result.add(Difference("fails", cycle, now.stage, inputs=inputs, text=text))
        left = sum(len(messages) for one in outputs.values() for messages in one.values())
        self.result.leave_out(cycle, left)

    def _outputs(self, cycle: int) -> dict[int, dict[str, Messages]]:
        """Return what each process of the agent published in a cycle, by stage.

        If none published anything, the newest one is there.
        """
        outputs: dict[int, dict[str, Messages]] = {}
        is_compared = cycle >= self.result.from_cycle
        for port, stage in self._stage_of.items():
            for message in self.recorded.on(port, cycle):
                self.result.recorded += is_compared
                messages = outputs.setdefault(message.incarnation, {}).setdefault(stage, {})
                is_second = messages.setdefault(port, message) is not message
                # A process killed in its first cycle has a successor of the same incarnation.
                if is_second and is_compared and not 0 < cycle == message.incarnation:
                    twice = Difference("sent twice", cycle, stage, str(port), content=message)
                    self.result.add(twice)
        return outputs or {self._newest_incarnation: {}}

    def _begin(self, cycle: int) -> Process:
        """Let a process of the agent join the run in a cycle."""
        loop = Loop(self.make(), self.plan)
        loop.begin(0, 0, cycle)
        process = Process(loop, self._stage_of)
        takeover = self.recorded.takeovers.get((self.name, cycle))
        if takeover is not None:
            loop.resume(takeover)
            process.joined_in = cycle
        elif cycle and self.recorded.was_away(self.name, cycle):
            process.lose_track()  # The recorder may have missed a takeover.
        return process

    def _run(self, now: CycleUnderWay) -> None:
        """Run a cycle of one process again."""
        if now.incarnation not in self._processes:
            self._processes[now.incarnation] = self._begin(now.incarnation)
        process = self._processes[now.incarnation]
        if not self.plan.timing.lockstep and not process.is_uncertain:
            self._find_lost_outputs(process, now)
        if process.is_uncertain:
            return
        stages = list(process.loop.agent.stages(now.cycle))
        unknown = now.recorded.keys() - {stage.name for stage in stages}
        if not (self.plan.timing.lockstep and now.is_last):
            while stages and stages[-1].name not in now.recorded:
                stages.pop()
        if stages:
            process.go_to(now.cycle * self.plan.timing.cycle_wall_ns)
        for together in _closing_together(stages):
            self._run_stages(process, now, together)
            if process.is_uncertain:
                return
        for name in unknown:
            now.stage = name
            self._compare(process, now, [])

    def _run_stages(self, process: Process, now: CycleUnderWay, stages: Sequence[Stage]) -> None:
        """Run again the stages that close together."""
        now.stage = first = stages[0].name
        if now.cycle == process.joined_in:  # Before it took over, a standby published nothing.
            stages = [stage for stage in stages if stage.name in now.recorded]
        inputs: Messages = {}
        certain = {stage.name for stage in stages if self._find_inputs(process, now, stage, inputs)}
        now.inputs |= inputs
        process.close(now.cycle, first, inputs)
        for stage in stages:
            now.stage = stage.name
            outputs = process.sent(now.cycle, stage.name)
            recorded = now.recorded.get(stage.name, {})
            if stage.name not in certain:
                process.lose_track()
            elif not recorded and not self.plan.timing.lockstep:
                if not self.recorded.was_away(self.name, now.cycle):
                    self.result.add(Difference("not recorded", now.cycle, stage.name))
                process.lose_track()
            elif now.has_doubtful_inputs and not self._are_equal(recorded, outputs):
                process.lose_track()
            else:
                self._compare(process, now, outputs)
            if process.is_uncertain:
                return

    def _find_inputs(
        self, process: Process, now: CycleUnderWay, stage: Stage, inputs: Messages
    ) -> bool:
        """Add the messages that a stage used to `inputs`; return whether all are recorded."""
        outputs = now.recorded.get(stage.name, {})
        if not outputs and not self.plan.timing.lockstep:
            return True  # It is unknown what it used.
        missing = next(iter(outputs.values())).missing if outputs else ()
        used_of = dict(map(parse_missing, missing))
        are_recorded = True
        for port in (*stage.awaits, *stage.uses):
            due = now.cycle - now.cycle % self._period[port]
            used = used_of.get(str(port), due)
            if used is None or used <= process.newest_used.get(port, -1):
                continue
            messages = self.recorded.on(port, used)
            if not messages:
                if not self.recorded.may_lack(port.publisher, used):
                    lost = Difference("input not recorded", now.cycle, stage.name, str(port))
                    self.result.add(lost)
                are_recorded = False
                continue
            now.has_doubtful_inputs |= self._may_be_another(port, messages)
            process.newest_used[port] = used
            inputs[port] = messages[0]
        return are_recorded

    def _may_be_another(self, port: Port[Message], messages: Sequence[Message]) -> bool:
        """Whether the agent may have used another message of a port and cycle than the first one.

        Several may be recorded. If not, a process and its successor may both have published one. In
        real time, without a standby, they cannot: the successor joins with a dispatch that was sent
        after the other one ended.
        """
        first, *others = messages
        joined = 0 < first.cycle == first.incarnation
        may_overlap = self.plan.timing.lockstep or port.publisher in self.plan.standbys
        return bool(others) or (joined and may_overlap)

    def _are_equal(self, recorded: Messages, outputs: Sequence[Delivery]) -> bool:
        new = dict(outputs)
        return recorded.keys() == new.keys() and not any(
            self.equality.differences(port, recorded[port], new[port]) for port in new
        )

    def _compare(self, process: Process, now: CycleUnderWay, outputs: Sequence[Delivery]) -> None:
        """Compare the outputs of the stage under way; remove what has been compared."""
        recorded = now.recorded.get(now.stage, {})
        for port, new in outputs:
            old = recorded.pop(port, None)
            if old is None:  # If the recording lost it, its number is known to be missing.
                sequence, cycle = process.sequences.get(port, (0, now.incarnation))
                process.sequences[port] = sequence + 1, cycle
                if self.recorded.was_away(self.name, new.cycle) or self.recorded.was_killed_in(
                    self.name, now.incarnation, new.cycle
                ):
                    continue
            self.result.compare(self.equality, port, old, new, now.stage, now.inputs)
        for port, old in recorded.items():
            self.result.compare(self.equality, port, old, None, now.stage, now.inputs)
        recorded.clear()

    def _find_lost_outputs(self, process: Process, now: CycleUnderWay) -> None:
        """Find gaps in the sequence numbers: the recording lost messages there."""
        for stage, outputs in now.recorded.items():
            for port, message in outputs.items():
                expected, since = process.sequences.get(port, (0, message.incarnation))
                if message.sequence > expected:
                    if not self.recorded.was_away(self.name, since, now.cycle):
                        key = str(port)
                        lost = Difference("not recorded", now.cycle, stage, key, content=message)
                        self.result.add(lost)
                    process.lose_track()
                process.sequences[port] = message.sequence + 1, now.cycle


def _closing_together(stages: Sequence[Stage]) -> list[list[Stage]]:
    """Return the stages of a cycle in lists: one stage, and those after it that await nothing."""
    closing: list[list[Stage]] = []
    for stage in stages:
        if not closing or stage.awaits or stage.timed:
            closing.append([])
        closing[-1].append(stage)
    return closing
