"""What is missing in a recording: messages, cycles without a message, inputs at deadlines.

Every message has a number on its key, from 0 on, and names the inputs that its sender missed.
Cycles and numbers alone count: messages may come in any order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.codec import UNREADABLE
from bus_schemas.messages import Message, parse_missing
from bus_schemas.signals import Occurrence, Port

if TYPE_CHECKING:
    from recordings.read.reader import RecordedMessage, RunReader

_NOTHING_MISSED = b"missing\x90"
"""In a payload: an empty list."""


class _Lacks(msgspec.Struct, gc=False):
    missing: tuple[str, ...] = ()


_decode_lacks = msgspec.msgpack.Decoder(_Lacks).decode


def lacks(payload: bytes) -> tuple[str, ...]:
    """Return the `missing` of a message; empty of a wrong one, which readers name."""
    if _NOTHING_MISSED not in payload:
        with suppress(*UNREADABLE):
            return _decode_lacks(payload).missing
    return ()


def due_step(plan: RunPlan, port: Port[Message]) -> int:
    """Return the cycles from one due message to the next; 0: it comes when it is needed."""
    comes_regularly = port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
    return plan.control.period(port) if comes_regularly else 0


class _Series:
    """Messages without a gap, one after the other: numbers first to last."""

    __slots__ = ("first", "first_cycle", "incarnation", "last", "last_cycle")

    def __init__(self, incarnation: int, cycle: int, number: int) -> None:
        self.incarnation = incarnation
        self.first_cycle = self.last_cycle = cycle
        self.first = self.last = number

    @property
    def place(self) -> tuple[int, int, int]:
        return self.incarnation, self.first_cycle, self.first


class Stretch(NamedTuple):
    """Cycles, first to last, in each of which a due message was recorded.

    lost: Messages between the stretch before and this one, by their numbers.
    is_anew: Whether it begins another process: its numbers begin from 0.
    """

    first: int
    last: int
    incarnation: int
    lost: int = 0
    is_anew: bool = False


class _Process:
    """The numbers of one process that were recorded, as spans in order."""

    def __init__(self, series: _Series) -> None:
        self.incarnation = series.incarnation
        self.newest_cycle = series.last_cycle
        self._spans = [(series.first, series.last)]

    def has_begun_anew(self, series: _Series) -> bool:
        """Whether a later series has numbers that this process has used before."""
        if series.incarnation > self.incarnation:
            return True
        is_used = any(first <= series.first <= last for first, last in reversed(self._spans))
        return is_used and series.first_cycle > self.newest_cycle

    def add(self, series: _Series) -> int:
        """Add the numbers of a series; return how many of them were there already."""
        self.newest_cycle = max(self.newest_cycle, series.last_cycle)
        first, last, again = series.first, series.last, 0
        if first > self._spans[-1][1] + 1:  # As nearly always.
            self._spans.append((first, last))
            return 0
        others = []
        for begin, end in self._spans:
            if end < first - 1 or begin > last + 1:
                others.append((begin, end))
                continue
            again += max(0, min(end, series.last) - max(begin, series.first) + 1)
            first, last = min(begin, first), max(end, last)
        self._spans = sorted([*others, (first, last)])
        return again

    @property
    def lost(self) -> int:
        between = sum(two[0] - one[1] - 1 for one, two in pairwise(self._spans))
        return self._spans[0][0] + between


class PortGaps:
    """The messages of one port, and what is missing between them.

    The messages of each process are numbered from 0. If numbers that were used come again in a
    newer cycle, a device has restarted; if not, a message came again.

    A message is due in every `step`-th cycle, or never if that is 0.
    """

    def __init__(self, step: int = 0) -> None:
        self.messages = 0
        self._step = step
        self._series: list[_Series] = []
        self._repeated = 0
        self._found: tuple[list[Stretch], int] | None = None

    def see(self, cycle: int, number: int, incarnation: int = 0) -> bool:
        """Count a message; return whether it follows the one before it without a gap."""
        self.messages += 1
        self._found = None
        if self._series:
            last = self._series[-1]
            step = cycle - last.last_cycle
            is_next = number == last.last + 1 and incarnation == last.incarnation
            if is_next and (step == self._step if self._step else step >= 0):
                last.last_cycle, last.last = cycle, number
                return True
        self._series.append(_Series(incarnation, cycle, number))
        return False

    @property
    def lost(self) -> int:
        return self._evaluated()[1]

    @property
    def repeated(self) -> int:
        self._evaluated()
        return self._repeated

    def stretches(self) -> list[Stretch]:
        return self._evaluated()[0]

    def has(self, cycle: int) -> bool:
        return any(one.first_cycle <= cycle <= one.last_cycle for one in reversed(self._series))

    @property
    def newest(self) -> int:
        stretches = self.stretches()
        return stretches[-1].last if stretches else -1

    def cycles(self, end: int) -> int:
        """Return how many due cycles before one have a message."""
        step = self._step
        return sum(
            len(range(one.first, min(one.last + 1, end), step))
            for one in self.stretches()
            if step and one.first % step == 0
        )

    def missing(self, end: int) -> int:
        """Return how many due cycles before one have no message."""
        if not self._step:
            return 0
        return len(range(0, end, self._step)) - self.cycles(end)

    def _evaluated(self) -> tuple[list[Stretch], int]:
        if self._found is None:
            self._found = self._evaluate()
        return self._found

    def _evaluate(self) -> tuple[list[Stretch], int]:
        """Return stretches and lost messages; join series that turn out to be one."""
        stretches: list[Stretch] = []
        joined: list[_Series] = []
        lost, process = 0, None
        for series in sorted(self._series, key=lambda one: one.place):
            begins = process is None or process.has_begun_anew(series)
            if process is None or begins:
                lost += process.lost if process else 0
                process = _Process(series)
                again = 0
            else:
                again = process.add(series)
            self._repeated += again
            if again > series.last - series.first:
                continue
            before = joined[-1] if joined and not begins else None
            if before and self._is_next(before, series):
                before.last, before.last_cycle = series.last, series.last_cycle
                stretches[-1] = stretches[-1]._replace(last=series.last_cycle)
                continue
            joined.append(series)
            self._add(stretches, series, before, begins=begins)
        self._series = joined
        return stretches, lost + (process.lost if process else 0)

    def _is_next(self, before: _Series, series: _Series) -> bool:
        step = series.first_cycle - before.last_cycle
        return series.first == before.last + 1 and (step == self._step if self._step else step >= 0)

    def _add(
        self, stretches: list[Stretch], series: _Series, before: _Series | None, *, begins: bool
    ) -> None:
        first, last = series.first_cycle, series.last_cycle
        if begins:  # A process that was replaced may go on: its later messages do not count.
            while stretches and stretches[-1].first >= first:
                stretches.pop()
            if stretches and stretches[-1].last >= first:
                stretches[-1] = stretches[-1]._replace(last=first - max(self._step, 1))
        elif stretches and last <= stretches[-1].last:
            return
        missing = series.first - before.last - 1 if before else series.first
        stretches.append(
            Stretch(
                max(first, stretches[-1].last + 1) if stretches else first,
                last,
                series.incarnation,
                max(missing, 0),
                begins and (bool(stretches) or series.incarnation > 0),
            )
        )


def gaps_of_ports(plan: RunPlan) -> dict[Port[Message], PortGaps]:
    logged = sorted((port for port in plan.wiring.ports if port.signal.logged), key=str)
    return {port: PortGaps(due_step(plan, port)) for port in logged}


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
        self._counted: dict[tuple[str, str, int], set[str]] = {}

    def see(self, record: RecordedMessage) -> list[str]:
        """Count what a record says; return the keys that its sender missed."""
        said = lacks(record.payload)
        return self.count(record.port, record.cycle, said) if said else []

    def count(self, port: Port[Message], cycle: int, said: tuple[str, ...]) -> list[str]:
        if not said or not port.signal.is_cyclic:
            return []
        agent, stage = port.publisher, stage_of(port, self._tree)
        # All messages of a stage say the same.
        counted = self._counted.setdefault((agent, stage, cycle), set())
        entries = [parse_missing(text) for text in said if text not in counted]
        counted.update(said)
        awaited = self._awaited.get((agent, stage, cycle % self._turns), ())
        missing = [entry.key for entry in entries if entry.key in awaited]
        old = sum(entry.cycle is not None for entry in entries)
        if missing or old:
            self.missing[agent].update(missing)
            self.old[agent] += old
            first, last = self.cycles.get(agent, (cycle, cycle))
            self.cycles[agent] = min(first, cycle), max(last, cycle)
        return missing


def unrecorded_spans(run: RunReader) -> Iterator[tuple[str, range]]:
    """Yield for each publisher cycles that damaged chunks or the time between files may hide."""
    for chunk in run.followed_chunks():
        run.messages_of(chunk, ())  # So that all damaged chunks are known.
    if not run.outline.breaks and not run.damage:
        return
    regular = {number: port for number, port in run.channels.items() if due_step(run.plan, port)}
    newest: dict[Port[Message], int] = {}
    seen_in: dict[Port[Message], int] = {}
    spans: dict[tuple[str, int], range] = {}
    part = file = 0  # The part of the recording between two losses.
    for chunk in run.followed_chunks():
        if (chunk.file != file and chunk.file in run.outline.breaks) or chunk in run.damage:
            part += 1
        file = chunk.file
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
