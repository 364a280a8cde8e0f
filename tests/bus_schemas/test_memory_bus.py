"""The bus inside one process: in the order of sending, or by a virtual clock."""

from __future__ import annotations

from bus_schemas.bus import Delivery, Outbox
from bus_schemas.faults import FaultRule
from bus_schemas.memory_bus import MemoryBus, VirtualClock
from bus_schemas.messages import Message, Notice, Ready, Residual, Setpoint
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import NOTICE, READY, RESIDUAL, SETPOINT, Port
from bus_schemas.tree import ROOT, ControlTree
from bus_schemas.wiring import Wiring

TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0)))
WIRING = Wiring("pair", TREE)
MS = 1_000_000


def residual(node: str, cycle: int) -> Delivery:
    return RESIDUAL.of(node), Residual(cycle, 0, node, (), power_kw=float(cycle))


def setpoint(node: str, cycle: int) -> Delivery:
    return SETPOINT.of(node), Setpoint(
        cycle, 0, "central", (), power_kw=1.0, share_kw=1.0, help_given=()
    )


def publish(bus: MemoryBus, *deliveries: Delivery, now_ns: int = 0) -> None:
    for port, message in deliveries:
        bus.publish(port, message, now_ns)


def received(bus: MemoryBus, until_ns: int | None = None) -> list[tuple[str, str, int]]:
    """Who gets what of which cycle, in order."""
    found = []
    while arrivals := bus.receive(until_ns):
        found += [(agent, str(port), message.cycle) for agent, port, message, _ in arrivals]
    return found


def test_messages_arrive_in_the_order_they_were_sent_whoever_gets_them() -> None:
    bus = MemoryBus(WIRING)
    publish(bus, residual("c1/b", 0), setpoint("c1", 0), residual("c1/a", 0), setpoint("c1", 1))
    assert received(bus) == [
        ("c1", "c1/b/residual", 0),
        ("c1", "c1/setpoint", 0),
        ("c1", "c1/a/residual", 0),
        ("c1", "c1/setpoint", 1),
    ]


def test_a_recorder_hears_the_very_messages_also_those_that_nobody_acts_on() -> None:
    heard: list[tuple[Port[Message], Message]] = []
    bus = MemoryBus(WIRING, lambda port, message: heard.append((port, message)))
    notice = Notice(0, 0, "c1", (), text="", count=1)
    publish(bus, (NOTICE.of("c1"), notice), residual("c1/a", 3))
    (arrival,) = bus.receive(None)
    assert [str(port) for port, _ in heard] == ["c1/notice", "c1/a/residual"]
    assert arrival.message is heard[1][1]


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


# By a virtual clock -------------------------------------------------------------------------------


def faulty(*rules: FaultRule) -> tuple[MemoryBus, VirtualClock]:
    clock = VirtualClock()
    return MemoryBus(WIRING, None, clock, NetworkFaults(rules, 1, TREE, 1_000 * MS)), clock


def test_the_clock_jumps_to_the_next_arrival_or_to_the_end_of_the_wait() -> None:
    bus, clock = faulty(FaultRule(delay_ms=30.0, signal="residual"))
    publish(bus, residual("c1/a", 0), setpoint("c1", 0))
    assert [arrival.time_ns for arrival in bus.receive(None)] == [0], "it has no delay"
    assert bus.receive(20 * MS) == ()
    assert clock.now_ns == 20 * MS
    (arrival,) = bus.receive(30 * MS)
    assert arrival.time_ns == clock.now_ns == 30 * MS, "at the end of the wait is in time"
    assert bus.receive(25 * MS) == ()
    assert clock.now_ns == 30 * MS, "it never goes back"
