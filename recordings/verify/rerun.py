"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins from the initial state, or, if it was a standby, from the state in its `takeover`.
A killed process may have sent a part of its last messages. In the cycle of a takeover both
processes may have published: each listener used what it heard first, and its outputs show which
that was.

Messages that are missing because the recorder was restarted are no difference, nor are those that a
killed process sent to others but not to the recorder. An agent that remembers earlier cycles is not
compared after that, until another process takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, Final

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

_MOST_CHOICES: Final = 256
"""Combinations of inputs that are tried at most, where standbys took over in a stage's cycle."""


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
        self._lost: dict[Port[Message], int] = {}
        # Of the cycle under way, and of the process that is run in it:
        self._rivals: dict[Port[Message], list[Message]] = {}
        self._inputs: Messages = {}
        self._choices: dict[Port[Message], list[Message]] = {}
        self._doubtful: set[Port[Message]] = set()
        self._compared = ""

    def take(self, cycle: int) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        outputs = self._outputs(cycle)
        if self.findings.failure is None:
            try:
                for self._incarnation, of_stages in sorted(outputs.items()):
                    self._inputs, self._choices, self._compared = {}, {}, ""
                    self._doubtful = set()
                    if self._incarnation not in self._processes:
                        self._processes[self._incarnation] = self._begin(self._incarnation)
                    self._run(cycle, of_stages, is_last=self._incarnation == max(outputs))
            except (Exception, SystemExit) as error:  # Every error of the tested code is a finding.
                text = f"{type(error).__name__}: {error}"
                self._add("fails", *self._failed_in(cycle), inputs=self._inputs, text=text)
        left = sum(len(messages) for one in outputs.values() for messages in one.values())
        self.findings.leave_out(cycle, left)

    def end(self) -> None:
        """Compare what the last process did not send: the run ended, nothing killed it."""
        if self._processes:
            self._incarnation = max(self._processes)
            self._compare_unsent()

    def _failed_in(self, cycle: int) -> tuple[int, str]:
        """Return the cycle and the stage in which the tested code failed."""
        process = self._processes.get(self._incarnation)
        if process is None or self._compared:
            return cycle, self._compared
        return process.loop.cycle, process.loop.stage

    @property
    def _process(self) -> Process:
        return self._processes[self._incarnation]

    def _outputs(self, cycle: int) -> dict[int, dict[str, Messages]]:
        """Return what each process of the agent published in a cycle, by stage.

        If none published anything, the one that published last is there.
        """
        found: dict[int, dict[str, Messages]] = {}
        self._rivals = {}
        for port, stage in self._stage_of.items():
            for message in self.recorded.heard[port].get(cycle, ()):
                self.findings.recorded += cycle >= self.findings.from_cycle
                messages = found.setdefault(message.incarnation, {}).setdefault(stage, {})
                if messages.setdefault(port, message) is message:
                    continue
                kind: str = "recorded twice"
                if self.recorded.has_two_senders(port, cycle):
                    self._rivals.setdefault(port, []).append(message)
                    kind = "two senders"
                elif 0 < cycle == message.incarnation:
                    continue  # Killed in the cycle in which it joined: its successor looks alike.
                if cycle >= self.findings.from_cycle:
                    self._add(kind, cycle, stage, port, message)
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
            self._compare_unsent()
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
        first = stages[0].name
        if cycle == process.began_in:  # Before it took over, a standby published nothing.
            stages = [stage for stage in stages if stage.name in recorded]
        self._compared = ""
        inputs: Messages = {}
        lost = {
            stage.name: self._find_inputs(cycle, stage, recorded.get(stage.name, {}), inputs)
            for stage in stages
        }
        if (self._choices or self._doubtful) and any(recorded.get(stage.name) for stage in stages):
            is_explained = self._choose_inputs(cycle, first, inputs, recorded)
            if not is_explained:
                for ports in lost.values():
                    ports.update(dict.fromkeys(self._doubtful, ""))
        self._inputs |= inputs
        process.close(cycle, first, inputs)
        for stage in stages:
            outputs = process.sent(cycle, stage.name)
            of_stage = recorded.get(stage.name, {})
            if not lost[stage.name] and (of_stage or self.plan.lockstep):
                self._compare(stage.name, of_stage, outputs)
            else:
                self._doubt(cycle, stage, lost[stage.name])
            if process.is_over:
                return

    def _find_inputs(
        self, cycle: int, stage: Stage, recorded: Messages, inputs: Messages
    ) -> dict[Port[Message], str]:
        """Add the messages that a stage used to `inputs`; return the ports of unknown ones.

        Each port comes with what is wrong; empty: nothing, the recorder could not hear it.
        """
        process = self._process
        missing = next(iter(recorded.values())).missing if recorded else ()
        used_of = dict(map(parse_missing, missing))
        lost: dict[Port[Message], str] = {}
        for port in (*stage.awaits, *stage.uses):
            due = cycle - cycle % self._period[port]
            used = used_of.get(str(port), due) if used_of else due
            if used is None or used <= process.heard[port]:
                continue
            messages = self.recorded.heard[port].get(used)
            if messages is None:
                is_excused = self._was_away(port.publisher, used) or self.recorded.may_lack(
                    port.publisher, used
                )
                lost[port] = "" if is_excused else "input not recorded"
                continue
            first = messages[0]
            if first.incarnation == used > 0 and self._may_overlap(port.publisher):
                self._doubtful.add(port)
            if len(messages) > 1:
                if self.recorded.has_two_senders(port, used):
                    lost[port] = "input of two senders"
                others = [one for one in messages if one.incarnation != first.incarnation]
                if others:
                    self._choices[port] = [first, *others]
            process.heard[port] = used
            inputs[port] = first
        return lost

    def _may_overlap(self, publisher: str) -> bool:
        """Whether a process and its successor may both have published the same cycle.

        In real time, without a standby, they cannot: the successor joins with a dispatch that was
        sent after the other one ended.
        """
        return self.plan.lockstep or publisher in self.plan.standbys

    def _choose_inputs(
        self, cycle: int, stage: str, inputs: Messages, recorded: dict[str, Messages]
    ) -> bool:
        """If two processes of an agent sent an input, choose the one that gives the outputs.

        Returns whether there is one. An earlier stage of the cycle may have heard it already
        without showing which it was.
        """
        for chosen in islice(product(*self._choices.values()), _MOST_CHOICES):
            tried = dict(zip(self._choices, chosen, strict=True))
            trial = self._process.twin()
            _use(tried, trial, inputs)
            trial.close(cycle, stage, inputs)
            if not any(
                self.comparison.differences(port, messages[port], new)
                for name, messages in recorded.items()
                for port, new in trial.sent(cycle, name)
                if port in messages
            ):
                _use(tried, self._process, inputs)
                return True
        _use({port: first for port, (first, *_) in self._choices.items()}, self._process, inputs)
        return False

    def _doubt(self, cycle: int, stage: Stage, lost: dict[Port[Message], str]) -> None:
        """Note that a stage used or sent a message that is not recorded.

        From here on the agent's state is uncertain.
        """
        for port, kind in lost.items():
            if kind and self._lost.get(port) != cycle:  # Both stages of a cycle may use it.
                self._lost[port] = cycle
                self._add(kind, cycle, stage.name, port, inputs=self._inputs)
        if not lost and not self._was_away(self.name, cycle):
            self._add("not recorded", cycle, stage.name)
        self._process.is_over = self._process.remembers

    def _compare(self, stage: str, recorded: Messages, outputs: Sequence[Delivery]) -> None:
        """Compare the outputs of a stage, and remove from `recorded` what has been compared."""
        process = self._process
        self._compared = stage
        for port, new in outputs:
            old = recorded.pop(port, None)
            for rival in self._rivals.get(port, ()):
                if not self.comparison.differences(port, rival, new):
                    old = rival
            if old is None:  # If the recording lost it, its number is known to be missing.
                process.unsent.append((port, new, stage, dict(self._inputs)))
                process.sequence[port] = process.sequence.get(port, 0) + 1
            else:
                self.findings.compare(self.comparison, port, old, new, stage, self._inputs)
        for port, old in recorded.items():
            self.findings.compare(self.comparison, port, old, None, stage, self._inputs)
        recorded.clear()

    def _compare_unsent(self) -> None:
        """Find what the process did not send, though it went on."""
        for port, new, stage, inputs in self._process.unsent:
            if not self._was_away(self.name, new.cycle):
                self.findings.compare(self.comparison, port, None, new, stage, inputs)
        self._process.unsent.clear()

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
                        self._add("not recorded", cycle, stage, port, message)
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

    def _add(
        self,
        kind: str,
        cycle: int,
        stage: str,
        port: Port[Message] | None = None,
        message: Message | None = None,
        inputs: Messages | None = None,
        text: str = "",
    ) -> None:
        key = "" if port is None else str(port)
        used = by_key(inputs or {})
        found = Difference(kind, cycle, stage, key, content=message, inputs=used, text=text)
        self.findings.add(found)


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


def _use(chosen: Messages, process: Process, inputs: Messages) -> None:
    """Let a stage use some messages: those among its inputs, or that its process has heard."""
    for port, message in chosen.items():
        if port in inputs:
            inputs[port] = message
        else:
            process.loop.use_instead(port, message)
