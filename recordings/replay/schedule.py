"""The order in which a replay sends messages, and when each is due."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from heapq import heappop, heappush
from itertools import takewhile
from typing import Final

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RecordedMessage, RunReader

_REORDER_NS: Final = 1_000_000_000
"""Longest time from publication to recording for which messages are put back into order."""

_LATE_CYCLES: Final = 10
"""By how many cycles a message may be published late, in addition to the longest period."""


def in_publish_order(
    reader: RunReader, ports: Collection[Port[Message]], cycles: range
) -> Iterator[RecordedMessage]:
    """Yield the messages of some cycles in the order of their publish times.

    Messages of one key keep their order.
    """
    beyond = cycles.stop + reader.plan.control.periods.longest + _LATE_CYCLES
    records = reader.records(ports, range(cycles.start, beyond + 1))
    # No message of these cycles follows one that is far beyond them.
    near = takewhile(lambda record: record.cycle < beyond, records)
    # The recorder receives messages in batches. The numbers keep the order of one moment.
    waiting: list[tuple[int, int, RecordedMessage]] = []
    for number, record in enumerate(record for record in near if record.cycle < cycles.stop):
        while waiting and waiting[0][0] <= record.log_time_ns - _REORDER_NS:
            yield heappop(waiting)[2]
        heappush(waiting, (record.publish_time_ns, number, record))
    while waiting:
        yield heappop(waiting)[2]


def positions(
    records: Iterable[RecordedMessage], plan: RunPlan
) -> Iterator[tuple[int, RecordedMessage]]:
    """Yield messages with their positions on a clock [ns]; only differences matter.

    In real time they are as far apart as when they were published. A cycle in lockstep has no
    length of its own: it begins at its simulated time. No position is before an earlier message's.
    """
    cycle, began_ns, last_ns = -1, 0, -(1 << 62)
    for record in records:
        position_ns = record.publish_time_ns
        if plan.timing.lockstep:
            if record.cycle > cycle:
                cycle, began_ns = record.cycle, record.publish_time_ns
            elapsed_ns = min(record.publish_time_ns - began_ns, plan.timing.cycle_ns)
            position_ns = plan.timing.sim_time_ns(record.cycle) + elapsed_ns
        last_ns = max(last_ns, position_ns)
        yield last_ns, record
