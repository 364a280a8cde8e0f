"""A recording to be replayed: payloads as they were on the wire, in the order of publishing."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import ROOT
from recordings.read.reader import RecordedMessage, RunReader

_REORDER_NS: Final = 1_000_000_000
"""How far behind its publishing a message may have been logged and still find its place."""

_STRAGGLER_CYCLES: Final = 10
"""How many cycles after its own a message can have been published, besides what periods allow."""

_ENDLESS: Final = 1 << 62


class RecordedRun:
    """The messages of a recording; of one that was cut, those up to the cut.

    Parameters
    ----------
    path
        The MCAP file, or the folder of a run.

    Attributes
    ----------
    path
        The MCAP file.
    plan
        Of the run.
    clock
        Turns moments of the run into cycles.
    whole
        Whether the file was closed in order.

    Raises
    ------
    InputError
        There is no such file, or it is no recording of a run.
    """

    def __init__(self, path: Path) -> None:
        self._reader = RunReader(path)
        self.path = self._reader.path
        self.plan = self._reader.plan
        self.clock = self._reader.clock
        self.whole = self._reader.whole

    @property
    def cycles(self) -> int:
        """Number of cycles that the recording has messages of, the last of them maybe not all."""
        return self._reader.last_cycle + 1

    @cached_property
    def complete_cycles(self) -> int:
        """Number of cycles that are complete: all of them, unless run or recording broke off."""
        end = range(self.cycles, self.cycles + 1)
        if any(self._reader.records([RUN.of(ROOT)], end)):
            return self.cycles
        return max(self.cycles - 1 - self.plan.periods.longest, 0)

    def records(
        self,
        ports: Collection[Port[Message]] | None = None,
        first_cycle: int = 0,
        before_cycle: int | None = None,
    ) -> Iterator[RecordedMessage]:
        """Return messages in the order of their publishing, those of one key always in theirs.

        Parameters
        ----------
        ports
            Of which ports; by default of all.
        first_cycle, before_cycle
            Messages of the cycles from the one to just before the other, by default to the end.

        Raises
        ------
        InputError
            When they are read: the file is damaged where it is read.
        """
        margin = self.plan.periods.longest + _STRAGGLER_CYCLES
        beyond = _ENDLESS if before_cycle is None else before_cycle + margin
        records = self._reader.records(ports, range(first_cycle, beyond + 1))
        return by_publish_time(_until(records, before_cycle or _ENDLESS, beyond))

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def __enter__(self) -> RecordedRun:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def by_publish_time(records: Iterable[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Sort what is nearly sorted, message by message: the recorder hears agents in batches.

    What was logged more than a second after its publishing comes as soon as it is read.
    """
    # From the right it is a few steps to a message's place, where a heap would touch them all.
    waiting: deque[RecordedMessage] = deque()
    for record in records:
        settled_ns = record.log_time_ns - _REORDER_NS
        while waiting and waiting[0].publish_time_ns <= settled_ns:
            yield waiting.popleft()
        place = len(waiting)
        while place and waiting[place - 1].publish_time_ns > record.publish_time_ns:
            place -= 1
        waiting.insert(place, record)
    yield from waiting


def _until(
    records: Iterable[RecordedMessage], before_cycle: int, beyond: int
) -> Iterator[RecordedMessage]:
    """Yield what is of cycles before one; end at the first that is far beyond it."""
    for record in records:
        if record.cycle < before_cycle:
            yield record
        elif record.cycle >= beyond:
            return
