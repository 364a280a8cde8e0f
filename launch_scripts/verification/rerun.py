"""One agent re-run on the inputs that its recorded outputs used.

Which inputs those were, the outputs tell: each carries the keys of the inputs that its sender had
to do without in that cycle, whether they came late, were dropped or never were sent. All other
inputs of the cycle it had, so the recording has them too. Deadlines need no clock then: a run in
real time is re-run like one in lockstep.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from agents.agent import Agent, Stage, Turn
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.verification.comparison import Comparison, FieldDifference
from launch_scripts.verification.recorded_cycles import RecordedCycle

Kind: TypeAlias = Literal[
    "differs", "only recorded", "only new", "recorded twice", "input not recorded", "fails"
]
"""`differs`: in its fields. `only recorded`: the agent does not say it now. `only new`: the
recording lacks it. `recorded twice`: in one cycle. `input not recorded`: the agent must have heard
something that the recording lacks. `fails`: the agent raises an error.

After one of the last two the agent's state is unknown, and it is not compared any more. In real
time the same after a stage of which the recording has nothing: what it lacked, nobody tells."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A recorded message that the agent does not send now, or the other way round.

    Attributes
    ----------
    kind
        In what they differ.
    cycle
        Number of the cycle.
    stage
        The agent's stage that sends the message, empty if none does.
    port
        What the message is about; of `input not recorded` the input.
    fields
        Fields that differ, of kind `differs`.
    message
        The message in question: the recorded one if there is one, else the new one.
    inputs
        What the agent was given in that cycle.
    missing
        Keys of the inputs that it had to do without.
    text
        What went wrong, of kind `fails`.
    """

    kind: Kind
    cycle: int
    stage: str
    port: Port[Message] | None
    fields: tuple[FieldDifference, ...] = ()
    message: Message | None = None
    inputs: tuple[Delivery, ...] = ()
    missing: tuple[str, ...] = ()
    text: str = ""


@dataclass(slots=True)
class Account:
    """What the comparison of one agent came to.

    Attributes
    ----------
    compared
        Pairs of messages that were held against each other.
    missed_inputs
        Inputs that the agent had to do without.
    counts
        Differences by kind.
    first
        The first of them.
    """

    compared: int = 0
    missed_inputs: int = 0
    counts: Counter[Kind] = field(default_factory=Counter)
    first: Difference | None = None

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is the first."""
        self.counts[difference.kind] += 1
        self.first = self.first or difference

    def absorb(self, later: Account) -> None:
        """Add what was not certain when it was found."""
        self.counts.update(later.counts)
        self.first = self.first or later.first


class AgentRerun:
    """One agent on its way through a recording.

    Parameters
    ----------
    agent
        The agent, as the code is now.
    says
        The ports on which it publishes, as far as they are recorded.
    plan
        Of the recorded run.
    comparison
        What counts as equal.

    Attributes
    ----------
    account
        What it came to so far.
    """

    def __init__(
        self,
        agent: Agent[Any],
        says: Collection[Port[Message]],
        plan: RunPlan,
        comparison: Comparison,
    ) -> None:
        self.agent = agent
        self.account = Account()
        self._says = frozenset(says)
        self._plan = plan
        self._comparison = comparison
        self._state = agent.initial_state()
        self._ended = False
        # What the recording lacks was lost, or never said because the agent had come to its end:
        # to be told apart once it speaks again, or not.
        self._unsaid = Account()
        self._lack: Difference | None = None

    def take(self, cycle: RecordedCycle) -> None:
        """Re-run a cycle and compare what the agent says in it with what it said."""
        recorded = {port: cycle.messages[port] for port in self._says.intersection(cycle.messages)}
        if recorded:
            self.account.absorb(self._unsaid)
            self._unsaid = Account()
        if self._ended:
            return
        rerun = _CycleRerun(cycle, {key for said in recorded.values() for key in said.missing})
        stages = self.agent.stages(cycle.number)
        if not all(self._close(stage, rerun) for stage in stages):
            self._ended = True
        self.account.missed_inputs += len(rerun.absent)
        self._compare(rerun, dict(recorded))
        self._ended |= not self._plan.lockstep and not rerun.is_told(stages, recorded)

    def conclude(self, stop_cycle: int | None, newest: Mapping[Port[Message], int]) -> None:
        """Settle what is not certain before the end of the recording.

        Parameters
        ----------
        stop_cycle
            All cycles before it took place, by the plant's word. None: the run or its recording
            broke off, so that of each key the last messages may be lost.
        newest
            Cycle of the newest message of each port.
        """
        if stop_cycle is not None:
            self.account.absorb(self._unsaid)
        lack = self._lack
        if lack is not None and lack.port is not None:
            took_place = stop_cycle is not None and lack.cycle < stop_cycle
            if took_place or newest.get(lack.port, -1) > lack.cycle:
                self.account.add(lack)

    def _close(self, stage: Stage, rerun: _CycleRerun) -> bool:
        """Close a stage with the inputs that it had. Return whether the agent can go on."""
        rerun.hear(stage)
        lacking = self._lacking(stage, rerun)
        if lacking:
            self._lack = rerun.difference("input not recorded", stage.name, lacking[0])
            return False
        number, sim_time_ns = rerun.cycle.number, self._plan.sim_time_ns(rerun.cycle.number)
        stamp = (number, sim_time_ns, self.agent.name, rerun.absent)
        turn = Turn(stage.name, number, sim_time_ns, stamp, rerun.inputs)
        try:
            self._state, outputs = self.agent.step(self._state, turn)
        except Exception as error:  # Whatever the code under test does wrong is a finding.
            text = f"{type(error).__name__}: {error}"
            self.account.add(rerun.difference("fails", stage.name, None, text=text))
            return False
        rerun.said += [(stage.name, port, message) for port, message in outputs]
        return True

    def _lacking(self, stage: Stage, rerun: _CycleRerun) -> list[Port[Message]]:
        """Return the inputs that the stage must have had, and that the recording lacks."""
        needed = set(stage.awaits)
        for port in stage.awaits.intersection(rerun.inputs):
            announced = self.agent.follow_up(port, rerun.inputs[port])
            if announced is not None:
                needed.add(announced)
        lacking = needed.difference(rerun.inputs)
        return sorted((port for port in lacking if str(port) not in rerun.missing), key=str)

    def _compare(self, rerun: _CycleRerun, recorded: dict[Port[Message], Message]) -> None:
        for stage, port, message in rerun.said:
            old = recorded.pop(port, None)
            if old is not None:
                self._compare_pair(rerun, stage, port, old, message)
            elif rerun.cycle.took_place:
                self._unsaid.add(rerun.difference("only new", stage, port, message=message))
        if not self._ended:
            for port, old in recorded.items():
                self.account.add(rerun.difference("only recorded", "", port, message=old))
        for port, old in rerun.cycle.repeated:
            if port in self._says:
                self.account.add(rerun.difference("recorded twice", "", port, message=old))

    def _compare_pair(
        self, rerun: _CycleRerun, stage: str, port: Port[Message], old: Message, new: Message
    ) -> None:
        self.account.compared += 1
        fields = self._comparison.differences(port, old, new)
        if fields:
            found = rerun.difference("differs", stage, port, message=old, fields=fields)
            self.account.add(found)


class _CycleRerun:
    """One agent in one cycle: what it was given, what it had to do without, what it says."""

    def __init__(self, cycle: RecordedCycle, missing: set[str]) -> None:
        self.cycle = cycle
        self.missing = missing
        self.inputs: dict[Port[Message], Message] = {}
        self.absent: tuple[str, ...] = ()
        self.said: list[tuple[str, Port[Message], Message]] = []

    def hear(self, stage: Stage) -> None:
        """Take in what the recording has for a stage, unless it did not arrive in time."""
        heard, messages = stage.awaits | stage.on_need, self.cycle.messages
        if not self.missing:
            self.inputs.update({port: messages[port] for port in heard if port in messages})
            return
        absent = self.missing.intersection(map(str, heard))
        # Of each stage in the order of the alphabet, as the sequencer has it.
        self.absent += tuple(sorted(absent))
        for port in heard:
            if port in messages and str(port) not in absent:
                self.inputs[port] = messages[port]

    def is_told(self, stages: Sequence[Stage], recorded: Collection[Port[Message]]) -> bool:
        """Whether a recorded message tells what the cycle's stages had to do without.

        Each tells of its own stage and those before it.
        """
        stage_of = {port: stage for stage, port, _ in self.said}
        telling = {stage_of.get(port, stages[-1].name) for port in recorded}
        for stage in reversed(stages):
            if stage.name in telling:
                return True
            if stage.awaits:
                return False
        return True

    def difference(
        self,
        kind: Kind,
        stage: str,
        port: Port[Message] | None,
        *,
        message: Message | None = None,
        fields: tuple[FieldDifference, ...] = (),
        text: str = "",
    ) -> Difference:
        """Return a difference in this cycle, with what the agent was given."""
        number, inputs = self.cycle.number, tuple(self.inputs.items())
        return Difference(kind, number, stage, port, fields, message, inputs, self.absent, text)
