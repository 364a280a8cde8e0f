"""The messages of a recording in the order in which they were published."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from typing import Final

from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage, RunReader

_REORDER_NS: Final = 1_000_000_000
"""A message that was logged later than this after its publication is not put back into order."""

_LATE_CYCLES: Final = 10
"""Cycles by which a message may be published late, besides what periods allow."""

_ENDLESS: Final = 1 << 62


def in_publish_order(
    reader: RunReader,
    ports: Collection[Port[Message]] | None = None,
    first_cycle: int = 0,
    before_cycle: int | None = None,
) -> Iterator[RecordedMessage]:
    """Yield the messages of some cycles in the order of their publish times.

    The cycles go from the first one to just before the other one, or to the end. Messages of one
    key keep their order.
    """
    margin = reader.plan.periods.longest + _LATE_CYCLES
    beyond = _ENDLESS if before_cycle is None else before_cycle + margin
    records = reader.records(ports, range(first_cycle, beyond + 1))
    return _sorted(_until(records, before_cycle or _ENDLESS, beyond))


def complete_cycles(reader: RunReader) -> int:
    """Return the number of complete cycles: all, unless the run or the recording broke off."""
    if reader.stop_cycle is not None:
        return reader.last_cycle + 1
    return max(reader.last_cycle - reader.plan.periods.longest, 0)


def _sorted(records: Iterable[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Sort messages that are nearly sorted: the recorder receives them in batches."""
    # Insertion from the right: a message is only a few places from where it belongs.
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
    """Yield the messages of cycles before one; end at the first that is far beyond it."""
    for record in records:
        if record.cycle < before_cycle:
            yield record
        elif record.cycle >= beyond:
            return
