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
compared after that, until another process takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from agents.agent import Agent, Stage
from agents.cycle import stage_of
from agents.loop import AgentLoop
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.missing import parse_missing
from bus_schemas.signals import Port
from recordings.verify.comparison import Comparison
from recordings.verify.findings import Difference, Findings, by_key
from recordings.verify.process import Messages, Process
from recordings.verify.recorded_cycles import RecordedCycles


@dataclass(eq=False)
class AgentRerun:
    """One agent on its way through a recording. It is made from the present code.

    absences: Of the recorder, see `recorder_absences`.
    """

    name: str
    make: Callable[[], Agent[Any]]
    plan: RunPlan
    recorded: RecordedCycles
    absences: Sequence[tuple[str, range]]
    comparison: Comparison
    from_cycle: int

    def __post_init__(self) -> None:
        plan, name = self.plan, self.name
        self.findings = Findings(from_cycle=self.from_cycle)
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.published[name]
            if port.signal.logged and port.signal.decided
        }
        self._period = {port: plan.period(port) for port in plan.wiring.heard.get(name, ())}
        self._processes: dict[int, Process] = {}
        self._incarnation = 0
        # Of the cycle under way, and of the process that is run in it:
        self._rivals: dict[Port[Message], list[Message]] = {}
        self._inputs: Messages = {}
        self._has_doubtful_inputs = False
        self._stage = ""

    def take(self, cycle: int) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        outputs = self._outputs(cycle)
        if self.findings.failure is None:
            try:
                for self._incarnation, of_stages in sorted(outputs.items()):
                    self._inputs, self._has_doubtful_inputs, self._stage = {}, False, ""
                    if self._incarnation not in self._processes:
                        self._processes[self._incarnation] = self._begin(self._incarnation)
                    self._run(cycle, of_stages, is_last=self._incarnation == max(outputs))
            except (Exception, SystemExit) as error:  # Every error of the tested code is a finding.
                text = f"{type(error).__name__}: {error}"
                inputs = by_key(self._inputs)
                self.findings.add(Difference("fails", cycle, self._stage, inputs=inputs, text=text))
        left = sum(len(messages) for one in outputs.values() for messages in one.values())
        self.findings.leave_out(cycle, left)

    @property
    def _process(self) -> Process:
        return self._processes[self._incarnation]

    def _outputs(self, cycle: int) -> dict[int, dict[str, Messages]]:
        """Return what each process of the agent published in a cycle, by stage.

        If none published anything, the one that published last is there.
        """
        found: dict[int, dict[str, Messages]] = {}
        self._rivals = {}
        is_wanted = cycle >= self.from_cycle
        for port, stage in self._stage_of.items():
            for message in self.recorded.on(port, cycle):
                self.findings.recorded += is_wanted
                messages = found.setdefault(message.incarnation, {}).setdefault(stage, {})
                if messages.setdefault(port, message) is message:
                    continue
                kind = "recorded twice"
                if self.recorded.has_two_senders(port, cycle):
                    self._rivals.setdefault(port, []).append(message)
                    kind = "two senders"
                elif 0 < cycle == message.incarnation:
                    continue  # Killed in the cycle in which it joined: its successor looks alike.
                if is_wanted:
                    self.findings.add(Difference(kind, cycle, stage, str(port), content=message))
        return found or {self._incarnation: {}}

    def _begin(self, cycle: int) -> Process:
        """Let a process of the agent join the run in a cycle."""
        agent = self.make()
        remembers = agent.initial_state() is not None
        loop = AgentLoop(agent, self.plan)
        loop.begin(0, 0, cycle)
        takeover = self.recorded.takeovers.get((self.name, cycle))
        if takeover is not None:
            loop.resume(takeover)
        began_in = -1 if takeover is None else cycle
        # The takeover itself may not be recorded.
        is_certain = takeover is not None or not cycle or not self._was_away(self.name, cycle)
        is_over = remembers and not is_certain
        return Process(
            loop, self._stage_of, remembers, began_in, is_over, dict.fromkeys(self._period, -1)
        )

    def _run(self, cycle: int, recorded: dict[str, Messages], *, is_last: bool) -> None:
        """Run a cycle of one process again; `is_last`: no newer process sent anything in it.

        What has been compared is removed from `recorded`.
        """
        process = self._process
        if recorded and not process.is_over:
            self._find_lost_outputs(cycle, recorded)
        if process.is_over:
            return
        stages = list(process.loop.agent.stages(cycle))
        unknown = recorded.keys() - {stage.name for stage in stages}
        if not (self.plan.lockstep and is_last):
            while stages and stages[-1].name not in recorded:
                stages.pop()
        if stages:
            process.go_to(cycle * self.plan.cycle_wall_ns)
        for together in _closing_together(stages):
            self._run_stages(cycle, together, recorded)
            if process.is_over:
                return
        for name in unknown:
            self._compare(name, recorded[name], [])

    def _run_stages(
        self, cycle: int, stages: Sequence[Stage], recorded: dict[str, Messages]
    ) -> None:
        """Run again the stages that close together."""
        process = self._process
        self._stage = first = stages[0].name
        if cycle == process.began_in:  # Before it took over, a standby published nothing.
            stages = [stage for stage in stages if stage.name in recorded]
        inputs: Messages = {}
        lost = {
            stage.name: self._find_inputs(cycle, stage, recorded.get(stage.name, {}), inputs)
            for stage in stages
        }
        self._inputs |= inputs
        process.close(cycle, first, inputs)
        for stage in stages:
            self._stage = stage.name
            outputs = process.sent(cycle, stage.name)
            of_stage = recorded.get(stage.name, {})
            is_certain = not lost[stage.name] and (of_stage or self.plan.lockstep)
            if not is_certain:
                self._doubt(cycle, stage, lost[stage.name])
            elif self._has_doubtful_inputs and not self._are_equal(of_stage, outputs):
                process.is_over = process.remembers
            else:
                self._compare(stage.name, of_stage, outputs)
            if process.is_over:
                return

    def _find_inputs(
        self, cycle: int, stage: Stage, recorded: Messages, inputs: Messages
    ) -> dict[Port[Message], str]:
        """Add the messages that a stage used to `inputs`; return the ports of unknown ones.

        Each port comes with what is wrong; empty: nothing, the recorder could not hear it.
        """
        process = self._process
        lost: dict[Port[Message], str] = {}
        if not recorded and not self.plan.lockstep:
            return lost  # Nobody knows what it used.
        missing = next(iter(recorded.values())).missing if recorded else ()
        used_of = dict(map(parse_missing, missing))
        for port in (*stage.awaits, *stage.uses):
            due = cycle - cycle % self._period[port]
            used = used_of.get(str(port), due)
            if used is None or used <= process.heard[port]:
                continue
            messages = self.recorded.on(port, used)
            if not messages:
                is_excused = self._was_away(port.publisher, used) or self.recorded.may_lack(
                    port.publisher, used
                )
                lost[port] = "" if is_excused else "input not recorded"
                continue
            if self._may_be_another(port, messages):
                self._has_doubtful_inputs = True
            if self.recorded.has_two_senders(port, used):
                lost[port] = "input of two senders"
            process.heard[port] = used
            inputs[port] = messages[0]
        return lost

    def _may_be_another(self, port: Port[Message], messages: Sequence[Message]) -> bool:
        """Whether a process and its successor may both have published messages of one cycle.

        In real time, without a standby, they cannot, unless both are recorded: the successor joins
        with a dispatch that was sent after the other one ended.
        """
        first, *others = messages
        if any(other.incarnation != first.incarnation for other in others):
            return True
        joined = 0 < first.cycle == first.incarnation
        return joined and (self.plan.lockstep or port.publisher in self.plan.standbys)

    def _are_equal(self, recorded: Messages, outputs: Sequence[Delivery]) -> bool:
        new = dict(outputs)
        return recorded.keys() == new.keys() and not any(
            self.comparison.differences(port, recorded[port], new[port]) for port in new
        )

    def _doubt(self, cycle: int, stage: Stage, lost: dict[Port[Message], str]) -> None:
        """Note that a stage used or sent a message that is not recorded.

        From here on the agent's state is uncertain.
        """
        for port, kind in lost.items():
            if kind:
                self.findings.add(Difference(kind, cycle, stage.name, str(port)))
        if not lost and not self._was_away(self.name, cycle):
            self.findings.add(Difference("not recorded", cycle, stage.name))
        self._process.is_over = self._process.remembers

    def _compare(self, stage: str, recorded: Messages, outputs: Sequence[Delivery]) -> None:
        """Compare the outputs of a stage, and remove from `recorded` what has been compared."""
        process = self._process
        for port, new in outputs:
            old = recorded.pop(port, None)
            for rival in self._rivals.get(port, ()):
                if not self.comparison.differences(port, rival, new):
                    old = rival
            if old is None:  # If the recording lost it, its number is known to be missing.
                process.sequence[port] = process.sequence.get(port, 0) + 1
                if self._was_away(self.name, new.cycle) or self.recorded.was_killed_in(
                    self.name, self._incarnation, new.cycle
                ):
                    continue
            self.findings.compare(self.comparison, port, old, new, stage, self._inputs)
        for port, old in recorded.items():
            self.findings.compare(self.comparison, port, old, None, stage, self._inputs)
        recorded.clear()

    def _find_lost_outputs(self, cycle: int, recorded: dict[str, Messages]) -> None:
        """In real time, find gaps in the sequence numbers: the recording lost messages there."""
        if self.plan.lockstep:
            return
        process = self._process
        for stage, outputs in recorded.items():
            for port, message in outputs.items():
                sequence, expected = message.sequence, process.sequence.get(port, 0)
                if any(rival.sequence == expected for rival in self._rivals.get(port, ())):
                    sequence = expected
                if sequence > expected:
                    since = process.spoke.get(port, message.incarnation)
                    if not self._was_away(self.name, since, cycle):
                        lost = Difference("not recorded", cycle, stage, str(port), content=message)
                        self.findings.add(lost)
                    process.is_over = process.remembers
                process.sequence[port] = sequence + 1
                process.spoke[port] = cycle

    def _was_away(self, publisher: str, first: int, last: int | None = None) -> bool:
        """Whether the recorder may have missed a publisher in a cycle, or in one of several."""
        last = first if last is None else last
        return any(
            name == publisher and first < absence.stop and last >= absence.start
            for name, absence in self.absences
        )


def _closing_together(stages: Sequence[Stage]) -> Iterator[list[Stage]]:
    """Yield the stages of a cycle in lists: one stage, and those after it that await nothing."""
    together: list[Stage] = []
    for stage in stages:
        if together and (stage.awaits or stage.timed):
            yield together
            together = []
        together.append(stage)
    if together:
        yield together
