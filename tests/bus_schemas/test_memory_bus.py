"""The bus inside one process: what it stamps on messages, and its virtual clock."""

from __future__ import annotations

from bus_schemas.bus import Delivery, Outbox
from bus_schemas.faults import Disturbance
from bus_schemas.memory_bus import MemoryBus, VirtualClock
from bus_schemas.messages import Ready, Residual
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import READY, RESIDUAL
from bus_schemas.tree import ROOT, ControlTree
from bus_schemas.wiring import Wiring

TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0)))
MS = 1_000_000


def residual(node: str, cycle: int) -> Delivery:
    return RESIDUAL.of(node), Residual(cycle, 0, node, (), power_kw=float(cycle))


def test_messages_are_stamped_and_those_of_the_run_numbered_and_counted() -> None:
    outbox = Outbox()
    said = [("c1/a", -8), ("c1/a", -7), ("c1/a", 0), ("c1/a", 1), ("c1/b", 1)]
    deliveries = [residual(*entry) for entry in said]
    for time_ns, delivery in enumerate(deliveries, start=100):
        outbox.stamp(*delivery, time_ns)
    stamps = [(message.publish_time_ns, message.sequence) for _, message in deliveries]
    assert stamps == [(100, 0), (101, 0), (102, 0), (103, 1), (104, 0)]
    outbox.stamp(READY.of(ROOT), Ready(0, 0, "recorder", ()), 7)  # It is not logged.
    assert outbox.published == {"residual": 3}


def test_the_clock_jumps_to_the_next_arrival_or_to_the_end_of_the_wait_and_never_back() -> None:
    clock, delayed = VirtualClock(), {0: Disturbance(delay_ms=30.0)}
    bus = MemoryBus(
        Wiring("pair", TREE).hearers, None, clock, NetworkFaults(delayed, 1, TREE, 1_000 * MS)
    )
    bus.publish(*residual("c1/a", 0), 0)
    assert bus.receive(20 * MS) == ()
    assert clock.now_ns == 20 * MS
    (arrival,) = bus.receive(30 * MS)
    assert arrival.time_ns == clock.now_ns == 30 * MS, "at the end of the wait is in time"
    assert bus.receive(25 * MS) == ()
    assert clock.now_ns == 30 * MS
