"""Runs one agent again on the inputs that it used, and compares what it publishes.

The recorded outputs say which inputs those were: `missing` names the inputs that were not the ones
due, and every other one was. So a run in real time is repeated as exactly as one in lockstep.

In lockstep an agent closes every stage of every cycle. In real time it may skip cycles: a stage
without recorded outputs was not closed. A process that replaced another says so in its messages:
its agent begins again, or, if it was a standby, with what the standby says that it knew. One that
was killed may have sent a part of its last messages. In the cycle of a takeover both processes may
have spoken: each listener used what it heard first, and its outputs show which that was.

What is missing because the recorder was away is no difference. An agent that remembers earlier
cycles is not compared after that, until another process takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from itertools import islice, product
from typing import Any, Final

from agents.agent import Agent, Stage
from agents.cycle import stage_of
from agents.loop import AgentLoop
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Takeover
from bus_schemas.missing import parse_missing
from bus_schemas.signals import Port
from recordings.verify.comparison import Comparison
from recordings.verify.findings import Difference, Findings, Kind, by_key
from recordings.verify.recorded_cycles import RecentMessages, RecordedCycle

_MOST_CHOICES: Final = 256
"""Combinations of inputs that are tried at most, where standbys took over in a stage's cycle."""


@dataclass(slots=True)
class _Process:
    """A process of an agent: an incarnation.

    Attributes
    ----------
    began_in
        The cycle in which a standby took over, maybe after its first stage; -1 for others.
    heard, sequence
        Newest cycle of each input, and number of the next message of each port.
    spoke
        Cycle of the last recorded message of each port.
    is_over
        Whether what the agent knows is not certain any more.
    unsent
        Messages of its last cycle that are not recorded, with stage and inputs: if it was killed
        there, nothing is wrong.
    """

    loop: AgentLoop[Any]
    began_in: int
    heard: dict[Port[Message], int]
    sequence: dict[Port[Message], int] = field(default_factory=dict)
    spoke: dict[Port[Message], int] = field(default_factory=dict)
    is_over: bool = False
    unsent: list[tuple[Port[Message], Message, str, dict[Port[Message], Message]]] = field(
        default_factory=list
    )


class AgentRerun:
    """One agent on its way through a recording. It is made from the present code."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        plan: RunPlan,
        recent: RecentMessages,
        takeovers: Mapping[tuple[str, int], Takeover],
        absences: Sequence[tuple[str, range]],
        comparison: Comparison,
        from_cycle: int,
    ) -> None:
        self.name = name
        self.findings = Findings(from_cycle=from_cycle)
        self._plan = plan
        self._recent = recent.of_port
        self._contested = recent.contested
        self._rivals: dict[Port[Message], list[Message]] = {}
        self._others = recent.others
        self._takeovers = takeovers
        self._absences = absences
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
        self._failed = False
        self._processes: dict[int, _Process] = {}
        try:
            self._agent = make()
            self._remembers = self._agent.initial_state() is not None
            self._process = self._begin(0)
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
            self._take(cycle.number, {}, is_last=True)
        for incarnation, messages in sorted(processes.items()):
            if not self._failed:
                try:
                    self._process = self._processes.get(incarnation) or self._begin(incarnation)
                except (Exception, SystemExit) as error:
                    self._fail(cycle.number, "", error)
            self._take(cycle.number, messages, is_last=incarnation == max(processes))

    def end(self) -> None:
        """Take the end of the run for what it is: nobody was killed there and replaced."""
        if self._processes:
            self._process = self._processes[max(self._processes)]
            self._compare_unsent()

    def _begin(self, cycle: int) -> _Process:
        """Let a process of the agent join the run in a cycle."""
        loop = AgentLoop(self._agent, self._plan)
        loop.begin(0, 0, cycle)
        takeover = self._takeovers.get((self.name, cycle))
        if takeover is not None:
            loop.resume(takeover)
        began_in = -1 if takeover is None else cycle
        process = _Process(loop, began_in, dict.fromkeys(self._period, -1))
        # A takeover may be what was not recorded.
        is_certain = takeover is not None or not cycle or not self._was_away(self.name, cycle)
        process.is_over = self._remembers and not is_certain
        self._processes[cycle] = process
        return process

    def _note_repeated(self, cycle: int, port: Port[Message], message: Message) -> None:
        kind: Kind = "recorded twice"
        if port in self._contested.get(cycle, ()):
            self._rivals.setdefault(port, []).append(message)
            kind = "two senders"
        if cycle >= self.findings.from_cycle:
            self.findings.recorded += 1
            self._add(kind, cycle, self._stage_of[port], port, message)

    def _take(self, number: int, messages: dict[Port[Message], Message], *, is_last: bool) -> None:
        """Run a cycle of one process again; `is_last`: no newer process sent anything in it."""
        findings = self.findings
        recorded: dict[str, dict[Port[Message], Message]] = {}
        for port, message in messages.items():
            recorded.setdefault(self._stage_of[port], {})[port] = message
        if number >= findings.from_cycle:
            findings.recorded += len(messages)
        if not self._is_over and messages:
            self._compare_unsent()
            self._find_lost_outputs(number, recorded)
        if not self._is_over:
            try:
                self._run(number, recorded, is_last=is_last)
            except (Exception, SystemExit) as error:
                self._fail(number, self._stage, error)
        findings.leave_out(number, sum(map(len, recorded.values())))

    @property
    def _is_over(self) -> bool:
        return self._failed or self._process.is_over

    def _run(
        self, cycle: int, recorded: dict[str, dict[Port[Message], Message]], *, is_last: bool
    ) -> None:
        stages = list(self._agent.stages(cycle))
        self._inputs, self._stage = {}, ""
        loop = self._process.loop
        if not (self._plan.lockstep and is_last):
            while stages and stages[-1].name not in recorded:
                stages.pop()
            if stages:
                loop.catch_up(cycle * self._plan.cycle_wall_ns)
        while stages and cycle == self._process.began_in and stages[0].name not in recorded:
            loop.close_stage(0)
            del stages[0]
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
        if recorded and self._others:
            self._choose_inputs(recorded)
        outputs = self._process.loop.close_stage(0)
        if not lost and (recorded or self._plan.lockstep):
            self._compare(cycle, stage.name, recorded, outputs)
            return
        # What the agent knows from here on is not certain.
        for port, kind in lost.items():
            if kind and self._lost.get(port) != cycle:  # Both stages of a cycle may use it.
                self._lost[port] = cycle
                self._add(kind, cycle, stage.name, port)
        if not lost and not self._was_away(self.name, cycle):
            self._add("not recorded", cycle, stage.name)
        self.findings.leave_out(cycle, len(recorded))
        recorded.clear()
        self._process.is_over = self._remembers

    def _hear_inputs(
        self, stage: Stage, cycle: int, missing: Sequence[str]
    ) -> dict[Port[Message], Kind | None]:
        """Give the agent the messages that a stage used; return the ports where it is not known.

        None in place of a kind: the recorder was away.
        """
        used_of = dict(map(parse_missing, missing))
        lost: dict[Port[Message], Kind | None] = {}
        for port in (*stage.awaits, *stage.uses):
            due = cycle - cycle % self._period[port]
            used = used_of.get(str(port), due) if used_of else due
            if used is None or used <= self._process.heard[port]:
                continue
            message = self._recent[port].get(used)
            if message is None:
                was_away = self._was_away(port.publisher, used)
                lost[port] = None if was_away else "input not recorded"
                continue
            if port in self._contested.get(used, ()):
                lost[port] = "input of two senders"
            self._process.heard[port] = used
            self._inputs[port] = message
            self._process.loop.hear(port, message, 0)
        return lost

    def _choose_inputs(self, recorded: dict[Port[Message], Message]) -> None:
        """Of inputs that two processes of an agent sent, use those that the outputs show."""
        loop = self._process.loop
        choices = {
            port: [message, *others]
            for port, message in self._inputs.items()
            if (others := self._others.get((port, message.cycle)))
        }
        for chosen in islice(product(*choices.values()), _MOST_CHOICES) if choices else ():
            for message, port in zip(chosen, choices, strict=True):
                loop.use_instead(port, message)
            outputs = copy(loop).close_stage(0)
            compared = [(port, recorded[port], new) for port, new in outputs if port in recorded]
            if not any(self._comparison.differences(*pair) for pair in compared):
                self._inputs |= dict(zip(choices, chosen, strict=True))
                return
        for port, messages in choices.items():
            loop.use_instead(port, messages[0])

    def _compare(
        self,
        cycle: int,
        stage: str,
        recorded: dict[Port[Message], Message],
        outputs: Sequence[Delivery],
    ) -> None:
        """Compare the outputs of a stage, and remove from `recorded` what has been compared."""
        sequence = self._process.sequence
        for port, new in outputs:
            old = recorded.pop(port, None)
            for rival in self._rivals.get(port, ()):
                if not self._comparison.differences(port, rival, new):
                    old = rival
            if old is None:  # If the recording lost it, its number is known to be missing.
                self._process.unsent.append((port, new, stage, dict(self._inputs)))
                sequence[port] = sequence.get(port, 0) + 1
            else:
                self.findings.compare(self._comparison, port, old, new, stage, self._inputs)
        for port, old in recorded.items():
            self.findings.compare(self._comparison, port, old, None, stage, self._inputs)
        recorded.clear()

    def _compare_unsent(self) -> None:
        """Find what the process did not send, though it went on."""
        for port, new, stage, inputs in self._process.unsent:
            if not self._was_away(self.name, new.cycle):
                self.findings.compare(self._comparison, port, None, new, stage, inputs)
        self._process.unsent.clear()

    def _find_lost_outputs(
        self, cycle: int, recorded: dict[str, dict[Port[Message], Message]]
    ) -> None:
        """In real time, find gaps in the sequence numbers: the recording lost messages there."""
        if self._plan.lockstep:
            return
        for stage, outputs in recorded.items():
            for port, message in outputs.items():
                sequence, expected = message.sequence, self._process.sequence.get(port, 0)
                if any(rival.sequence == expected for rival in self._rivals.get(port, ())):
                    sequence = expected
                if sequence > expected:
                    since = self._process.spoke.get(port, message.incarnation)
                    if not self._was_away(self.name, since, cycle):
                        self._add("not recorded", cycle, stage, port, message)
                    self._process.is_over = self._remembers
                self._process.sequence[port] = sequence + 1
                self._process.spoke[port] = cycle

    def _was_away(self, publisher: str, first: int, last: int | None = None) -> bool:
        """Whether the recorder may have missed a publisher in a cycle, or in one of several."""
        last = first if last is None else last
        return any(
            name == publisher and first < absence.stop and last >= absence.start
            for name, absence in self._absences
        )

    def _fail(self, cycle: int, stage: str, error: BaseException) -> None:
        text = f"{type(error).__name__}: {error}"
        inputs = by_key(self._inputs)
        self.findings.add(Difference("fails", cycle, stage, inputs=inputs, text=text))
        self._failed = True

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
