"""Counts the inputs that were missing at deadlines, as the messages of a recording say.

This is the one place that counts them, for the summary of a run, `inspect` and `timing`.
"""

from __future__ import annotations

from collections import Counter

from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.messages import Message
from bus_schemas.missing import parse_missing
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage

_NOTHING_MISSED = b"missing\x90"
"""In a payload: an empty list."""


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
        self._turns = plan.periods.longest
        self._counted: dict[tuple[str, str], int] = {}

    def see(self, record: RecordedMessage) -> None:
        if _NOTHING_MISSED not in record.payload:
            self.count(record.port, record.message())

    def count(self, port: Port[Message], message: Message) -> None:
        if not message.missing:
            return
        agent, cycle, stage = port.publisher, message.cycle, stage_of(port, self._tree)
        if cycle <= self._counted.get((agent, stage), -1):
            return  # All messages of a stage say the same.
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
