"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from recordings.verify.findings import Difference, Findings, Kind, by_key
from recordings.verify.recorded_cycles import RecentMessages, RecordedCycle


class AgentRerun:
    """One agent on its way through a recording. It is made from the present code."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        plan: RunPlan,
        recent: RecentMessages,
        comparison: Comparison,
        from_cycle: int,
    ) -> None:
        self.name = name
        self.findings = Findings(from_cycle=from_cycle)
        self._plan = plan
        self._recent = recent.of_port
        self._contested = recent.contested
        self._rivals: dict[Port[Message], list[Message]] = {}
        self._comparison = comparison
        self._stage_of = {
            port: stage_of(port, plan.tree)
            for port in plan.wiring.published[name]
            if port.signal.logged and port.signal.decided
        }
        self._period = {port: plan.period(port) for port in plan.wiring.heard.get(name, ())}
        self._inputs: dict[Port[Message], Message] = {}
        self._lost: dict[Port[Message], int] = {}
        self._stage = ""
        self._is_over = self._failed = False
        self._incarnation = 0
        try:
            self._agent = make()
            self._remembers = self._agent.initial_state() is not None
            self._begin(0)
        except (Exception, SystemExit) as error:  # Every error of the tested code is a finding.
            self._fail(0, "", error)

    def take(self, cycle: RecordedCycle) -> None:
        """Run a cycle again and compare what the agent publishes in it."""
        processes: dict[int, dict[Port[Message], Message]] = {}
        self._rivals = {}
        for port in self._stage_of:
            if (message := cycle.messages.get(port)) is not None:
                processes.setdefault(message.incarnation, {})[port] = message
        for port, message in cycle.repeated:
            if port in self._stage_of:
                published = processes.setdefault(message.incarnation, {})
                if published.setdefault(port, message) is not message:
                    self._note_repeated(cycle.number, port, message)
        if not processes:
            self._take(cycle.number, {})
        for incarnation, messages in sorted(processes.items()):
            if incarnation > self._incarnation and not self._failed:
                self._begin(incarnation)
                self._is_over = False
            self._take(cycle.number, messages)

    def _begin(self, cycle: int) -> None:
        """Let a process of the agent join the run in a cycle."""
        self._loop = AgentLoop(self._agent, self._plan)
        self._loop.begin(0, 0, cycle)
        self._incarnation = cycle
        self._heard = dict.fromkeys(self._period, -1)
        self._sequence: dict[Port[Message], int] = {}

    def _note_repeated(self, cycle: int, port: Port[Message], message: Message) -> None:
        kind: Kind = "recorded twice"
        if port in self._contested.get(cycle, ()):
            self._rivals.setdefault(port, []).append(message)
            kind = "two senders"
        if cycle >= self.findings.from_cycle:
            self.findings.recorded += 1
            self._add(kind, cycle, self._stage_of[port], port, message)

    def _take(self, number: int, messages: dict[Port[Message], Message]) -> None:
        """Run a cycle of one process again."""
        findings = self.findings
        recorded: dict[str, dict[Port[Message], Message]] = {}
        for port, message in messages.items():
            recorded.setdefault(self._stage_of[port], {})[port] = message
        if number >= findings.from_cycle:
            findings.recorded += len(messages)
        if not self._is_over:
            self._find_lost_outputs(number, recorded)
        if not self._is_over:
            try:
                self._run(number, recorded)
            except (Exception, SystemExit) as error:
                self._fail(number, self._stage, error)
            findings.missing_inputs = self._loop.missing_inputs
            findings.old_inputs = self._loop.old_inputs
        findings.leave_out(number, sum(map(len, recorded.values())))

    def _run(self, cycle: int, recorded: dict[str, dict[Port[Message], Message]]) -> None:
        stages = list(self._agent.stages(cycle))
        self._inputs, self._stage = {}, ""
        if not self._plan.lockstep:
            while stages and stages[-1].name not in recorded:
                stages.pop()
            if stages:
                self._loop.catch_up(cycle * self._plan.cycle_wall_ns)
        for stage in stages:
            self._run_stage(cycle, stage, recorded.get(stage.name, {}))
            if self._is_over:
                return
        for name, left in recorded.items():  # Of stages that the agent does not have any more.
            self._compare(cycle, name, left, [])

    def _run_stage(self, cycle: int, stage: Stage, recorded: dict[Port[Message], Message]) -> None:
        missing = next(iter(recorded.values())).missing if recorded else ()
        self._stage = stage.name
        lost = self._hear_inputs(stage, cycle, missing)
        outputs = self._loop.close_stage(0)
        if not lost and (recorded or self._plan.lockstep):
            self._compare(cycle, stage.name, recorded, outputs)
            return
        # What the agent knows from here on is not certain.
        for port, kind in lost.items():
            if self._lost.get(port) != cycle:  # Both stages of a cycle may use it.
                self._lost[port] = cycle
                self._add(kind, cycle, stage.name, port)
        if not lost:
            self._add("not recorded", cycle, stage.name)
        self.findings.leave_out(cycle, len(recorded))
        recorded.clear()
        self._is_over = self._remembers

    def _hear_inputs(
        self, stage: Stage, cycle: int, missing: Sequence[str]
    ) -> dict[Port[Message], Kind]:
        """Give the agent the messages that a stage used; return the ports where it is not known."""
        used_of = dict(map(parse_missing, missing))
        lost: dict[Port[Message], Kind] = {}
        for port in (*stage.awaits, *stage.uses):
            due = cycle - cycle % self._period[port]
            used = used_of.get(str(port), due) if used_of else due
            if used is None or used <= self._heard[port]:
                continue
            message = self._recent[port].get(used)
            if message is None:
                lost[port] = "input not recorded"
                continue
            if port in self._contested.get(used, ()):
                lost[port] = "input of two senders"
            self._heard[port] = used
            self._inputs[port] = message
            self._loop.hear(port, message, 0)
        return lost

    def _compare(
        self,
        cycle: int,
        stage: str,
        recorded: dict[Port[Message], Message],
        outputs: Sequence[Delivery],
    ) -> None:
        """Compare the outputs of a stage, and remove from `recorded` what has been compared."""
        for port, new in outputs:
            old = recorded.get(port)
            for rival in self._rivals.get(port, ()):
                if not self._comparison.differences(port, rival, new):
                    old = rival
            self.findings.compare(self._comparison, port, old, new, stage, self._inputs)
            recorded.pop(port, None)
            if old is None:  # If the recording lost it, its number is known to be missing.
                self._sequence[port] = self._sequence.get(port, 0) + 1
        for port, old in recorded.items():
            self.findings.compare(self._comparison, port, old, None, stage, self._inputs)
        recorded.clear()

    def _find_lost_outputs(
        self, cycle: int, recorded: dict[str, dict[Port[Message], Message]]
    ) -> None:
        """In real time, find gaps in the sequence numbers: the recording lost messages there."""
        if self._plan.lockstep:
            return
        for stage, outputs in recorded.items():
            for port, message in outputs.items():
                sequence, expected = message.sequence, self._sequence.get(port, 0)
                if any(rival.sequence == expected for rival in self._rivals.get(port, ())):
                    sequence = expected
                if sequence > expected:
                    self._add("not recorded", cycle, stage, port, message)
                    self._is_over = self._remembers
                self._sequence[port] = sequence + 1

    def _fail(self, cycle: int, stage: str, error: BaseException) -> None:
        text = f"{type(error).__name__}: {error}"
        inputs = by_key(self._inputs)
        self.findings.add(Difference("fails", cycle, stage, inputs=inputs, text=text))
        self._is_over = self._failed = True

    def _add(
        self,
        kind: Kind,
        cycle: int,
        stage: str,
        port: Port[Message] | None = None,
        message: Message | None = None,
    ) -> None:
        inputs = by_key(self._inputs) if kind.startswith("input") else {}
        key = "" if port is None else str(port)
        self.findings.add(Difference(kind, cycle, stage, key, content=message, inputs=inputs))
