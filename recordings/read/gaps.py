"""What is missing in a recording: messages, cycles without a message, inputs at deadlines.

Every message has a number on its key, from 0 on, and names the inputs that its sender missed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, parse_missing
from bus_schemas.signals import Occurrence, Port

if TYPE_CHECKING:
    from recordings.read.reader import RecordedMessage, RunReader

NOTHING_MISSED = b"missing\x90"
"""In a payload: an empty list."""


def due_step(plan: RunPlan, port: Port[Message]) -> int:
    """Return the cycles from one due message to the next; 0: it comes when it is needed."""
    comes_regularly = port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
    return plan.control.period(port) if comes_regularly else 0


class PortGaps:
    """The messages of one port from `first_cycle` on, and what is missing between them.

    The messages of each incarnation are numbered from 0. Numbers of a process that was replaced are
    ignored. A number lower than expected means that a device has restarted, if the cycle is newer;
    if not, that a message came again.

    `cycles` counts messages of a cycle newer than those of all before them, so each cycle once.
    `missing` counts the cycles in which a message was due and none came: one is due in every
    `step`-th cycle, or never if that is 0. `newest` is the newest cycle of a message. `restarts`
    counts how often one incarnation began its numbers anew.
    """

    def __init__(self, step: int = 0, first_cycle: int = 0) -> None:
        self.messages = self.cycles = self.missing = self.lost = self.repeated = self.restarts = 0
        self._step = step
        self._due = -(-first_cycle // step) * step - step if step else 0
        self.newest = first_cycle - 1
        self._incarnation = 0
        self._expected: int | None = None if first_cycle else 0

    def see(self, cycle: int, sequence: int, incarnation: int = 0) -> None:
        """Count a message, and the cycles before it in which one was due and none came."""
        self.messages += 1
        self.cycles += cycle > self.newest
        self.end(cycle)
        if self._expected is None:
            self._expected, self._incarnation = sequence, incarnation
        if incarnation < self._incarnation:
            return
        if incarnation > self._incarnation or sequence < self._expected:
            if incarnation == self._incarnation and cycle <= self.newest:
                self.repeated += 1
                return
            self._expected = 0
            self.restarts += incarnation == self._incarnation
        self.lost += sequence - self._expected
        self._expected, self._incarnation = sequence + 1, incarnation
        self.newest = max(cycle, self.newest)

    def end(self, cycle: int) -> None:
        """Count the cycles before this one in which a message was due and none came."""
        if self._step and cycle > self._due:
            self.missing += len(range(self._due + self._step, cycle, self._step))
            self._due = cycle


def gaps_of_ports(plan: RunPlan, first_cycle: int = 0) -> dict[Port[Message], PortGaps]:
    logged = sorted((port for port in plan.wiring.ports if port.signal.logged), key=str)
    return {port: PortGaps(due_step(plan, port), first_cycle) for port in logged}


class MissedInputs:
    """Counts the missed inputs of each agent, each once in a stage.

    `missing`: inputs that had not come at a deadline, by agent and key. `old`: older messages that
    were used instead. `cycles`: the first and the last cycle with either.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.missing: dict[str, Counter[str]] = {agent: Counter() for agent in plan.tree.agents()}
        self.old: Counter[str] = Counter()
        self.cycles: dict[str, tuple[int, int]] = {}
        self._tree = plan.tree
        self._awaited = {
            (agent, stage.name, turn): {str(port) for port in stage.awaits}
            for agent, turns in stages_of_agents(plan).items()
            for turn, stages in enumerate(turns)
            for stage in stages
        }
        self._turns = plan.control.periods.longest
        self._counted: dict[tuple[str, str], int] = {}

    def see(self, record: RecordedMessage) -> list[str]:
        """Count what a record says; return the keys that its sender missed."""
        if NOTHING_MISSED in record.payload:
            return []
        try:
            return self.count(record.port, record.message())
        except InputError:  # The reader names a wrong message.
            return []

    def count(self, port: Port[Message], message: Message) -> list[str]:
        if not message.missing or not port.signal.is_cyclic:
            return []
        agent, cycle, stage = port.publisher, message.cycle, stage_of(port, self._tree)
        if cycle <= self._counted.get((agent, stage), -1):
            return []  # All messages of a stage say the same.
        self._counted[agent, stage] = cycle
        awaited = self._awaited.get((agent, stage, cycle % self._turns), ())
        entries = list(map(parse_missing, message.missing))
        missing = [entry.key for entry in entries if entry.key in awaited]
        old = sum(entry.cycle is not None for entry in entries)
        if missing or old:
            self.missing[agent].update(missing)
            self.old[agent] += old
            first, _ = self.cycles.get(agent, (cycle, cycle))
            self.cycles[agent] = first, cycle
        return missing


def unrecorded_spans(run: RunReader) -> Iterator[tuple[str, range]]:
    """Yield for each publisher cycles that may be missing, in damaged chunks or between two files.

    The first and the last of them may be recorded in part, or as a whole.
    """
    for chunk in run.followed_chunks():
        run.messages_of(chunk, ())  # So that all damaged chunks are known.
    if len(run.files) == 1 and not run.damage:
        return
    regular = {number: port for number, port in run.channels.items() if due_step(run.plan, port)}
    newest: dict[Port[Message], int] = {}
    seen_in: dict[Port[Message], int] = {}
    spans: dict[tuple[str, int], range] = {}
    part = file = 0  # The part of the recording between two losses.
    for chunk in run.followed_chunks():
        if chunk.file != file or chunk in run.damage:
            file, part = chunk.file, part + 1
        for record in run.records_of(chunk, regular):
            port, cycle = record.port, record.cycle
            if seen_in.get(port, 0) < part:
                key = port.publisher, part
                before = spans.get(key, range(cycle, cycle))
                first = min(newest.get(port, 0), before.start)
                spans[key] = range(first, max(cycle + 1, before.stop))
            seen_in[port] = part
            newest[port] = max(cycle, newest.get(port, 0))
    for (publisher, _), span in spans.items():
        yield publisher, span
