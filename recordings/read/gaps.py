"""What is missing in a recording: messages, by gaps in their numbers, and cycles without a message.

Every message has a number on its key, from 0 on. This is the one place that counts what the
numbers leave out: `inspect`, `recover`, `verify`, the recorder and the page all use it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import msgspec

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port

if TYPE_CHECKING:
    from recordings.read.reader import RunReader

LISTED_GAPS: Final = 100
"""So many gaps are kept with their place."""


class Gap(msgspec.Struct, frozen=True):
    """Cycles without the message that was due in them."""

    port: str
    first_cycle: int
    last_cycle: int
    cycles: int


def due_step(plan: RunPlan, port: Port[Message]) -> int:
    """Return the cycles from one due message to the next; 0: it comes when it is needed."""
    comes_regularly = port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
    return plan.period(port) if comes_regularly else 0


class PortGaps:
    """The messages of one port from `first_cycle` on, and what is missing between them.

    The messages of each incarnation are numbered from 0. Numbers of a process that was replaced are
    ignored. A number lower than expected means that a device has restarted, if the cycle is newer;
    if not, that a message came again.

    `missing` counts the cycles in which a message was due and none came: one is due in every
    `step`-th cycle, or never if that is 0. `newest` is the newest cycle of a message.
    """

    def __init__(self, step: int = 0, first_cycle: int = 0) -> None:
        self.messages = self.missing = self.lost = self.repeated = self.restarts = 0
        self._step = step
        self._due = -(-first_cycle // step) * step - step if step else 0
        self.newest = first_cycle - 1
        self._incarnation = 0
        self._expected: int | None = None if first_cycle else 0

    def see(self, cycle: int, sequence: int, incarnation: int = 0) -> range:
        """Count a message; return the cycles before it in which one was due and none came."""
        self.messages += 1
        if self._expected is None:
            self._expected, self._incarnation = sequence, incarnation
        if incarnation < self._incarnation:
            return self.end(cycle)
        if incarnation > self._incarnation or sequence < self._expected:
            if incarnation == self._incarnation and cycle <= self.newest:
                self.repeated += 1
                return range(0)
            self._expected = 0
            self.restarts += 1
        self.lost += sequence - self._expected
        self._expected, self._incarnation = sequence + 1, incarnation
        self.newest = max(cycle, self.newest)
        return self.end(cycle)

    def end(self, cycle: int) -> range:
        """Return the cycles before this one in which a message was due and none came."""
        if not self._step or cycle <= self._due:
            return range(0)
        gap = range(self._due + self._step, cycle, self._step)
        self._due = cycle
        self.missing += len(gap)
        return gap


class RunGaps:
    """What is missing in a run, port by port."""

    def __init__(self, plan: RunPlan, first_cycle: int = 0) -> None:
        logged = sorted((port for port in plan.wiring.ports if port.signal.logged), key=str)
        self.ports = {port: PortGaps(due_step(plan, port), first_cycle) for port in logged}
        self.gaps: list[Gap] = []

    def see(self, port: Port[Message], cycle: int, sequence: int, incarnation: int = 0) -> None:
        if gap := self.ports[port].see(cycle, sequence, incarnation):
            self._note(port, gap)

    def end(self, cycle: int) -> None:
        """Note what was due before the cycle that the run ended with."""
        for port, found in self.ports.items():
            if gap := found.end(cycle):
                self._note(port, gap)

    @property
    def lost(self) -> int:
        """Messages that the numbers leave out."""
        return sum(found.lost for found in self.ports.values())

    def _note(self, port: Port[Message], gap: range) -> None:
        if len(self.gaps) < LISTED_GAPS:
            self.gaps.append(Gap(str(port), gap[0], gap[-1], len(gap)))


def recorder_absences(run: RunReader) -> Iterator[tuple[str, range]]:
    """Yield for each publisher the cycles that the recorder may have missed: between two files.

    The first and the last of them may be recorded in part, or as a whole.
    """
    if len(run.files) == 1:
        return
    newest: dict[Port[Message], int] = {}
    seen_in: dict[Port[Message], int] = {}
    absences: dict[tuple[str, int], range] = {}
    regular = [port for port in run.ports() if due_step(run.plan, port)]
    for port, cycle, *_ in run.records(regular):
        file = run.file_number
        if seen_in.get(port, 0) < file:
            key = port.publisher, file
            before = absences.get(key, range(cycle, cycle))
            first = min(newest.get(port, 0), before.start)
            absences[key] = range(first, max(cycle + 1, before.stop))
        seen_in[port] = file
        newest[port] = max(cycle, newest.get(port, 0))
    for (publisher, _), absence in absences.items():
        yield publisher, absence
