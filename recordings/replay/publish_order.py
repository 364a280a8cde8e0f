"""The messages of a recording in the order in which they were published."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from heapq import heappop, heappush
from itertools import takewhile
from typing import Final

from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage, RunReader

_REORDER_NS: Final = 1_000_000_000
"""A message that was logged later than this after its publication is not put back into order."""

_LATE_CYCLES: Final = 10
"""Cycles by which a message may be published late, besides what periods allow."""


def in_publish_order(
    reader: RunReader, ports: Collection[Port[Message]], cycles: range
) -> Iterator[RecordedMessage]:
    """Yield the messages of some cycles in the order of their publish times.

    Messages of one key keep their order.
    """
    beyond = cycles.stop + reader.plan.periods.longest + _LATE_CYCLES
    records = reader.records(ports, range(cycles.start, beyond + 1))
    # Nothing of the cycles comes after a message that is far beyond them.
    near = takewhile(lambda record: record.cycle < beyond, records)
    return _sorted(record for record in near if record.cycle < cycles.stop)


def complete_cycles(reader: RunReader) -> int:
    """Return the number of complete cycles: all, unless the run or the recording broke off."""
    if reader.stop_cycle is not None:
        return reader.last_cycle + 1
    return max(reader.last_cycle - reader.plan.periods.longest, 0)


def _sorted(records: Iterable[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Sort messages that are nearly sorted: the recorder receives them in batches."""
    # The numbers keep the order of messages that were published at one moment.
    waiting: list[tuple[int, int, RecordedMessage]] = []
    for number, record in enumerate(records):
        while waiting and waiting[0][0] <= record.log_time_ns - _REORDER_NS:
            yield heappop(waiting)[2]
        heappush(waiting, (record.publish_time_ns, number, record))
    while waiting:
        yield heappop(waiting)[2]
