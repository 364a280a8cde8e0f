"""Delayed, lost and doubled messages at one agent's end of its links."""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

from clock_by_hand import ClockByHand

from bus_schemas.bus import Arrival
from bus_schemas.faults import FaultRule
from bus_schemas.faulty_bus import FaultyBus
from bus_schemas.messages import Telemetry
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import TELEMETRY
from bus_schemas.tree import PLANT, ControlTree

TREE = ControlTree((("a", 100.0), ("b", 100.0)))
PORT = TELEMETRY.of("a")
MS = 1_000_000
RULES = (
    FaultRule(delay_ms=40.0),
    FaultRule(silent=((10.0, 20.0),)),
    FaultRule(reorder=1.0, reorder_ms=0.001, duplicate=0.5),
)
"""Cycles are seconds here: nothing of the cycles 10 to 19 arrives."""

FAULTS = NetworkFaults(RULES, 1, TREE, 1_000 * MS)


def telemetry(cycle: int) -> Telemetry:
    return Telemetry(cycle, 0, PLANT, (), power_kw=1.0, alpha=1.0, limit_kw=1.0)


def copies(cycle: int) -> int:
    return len(FAULTS.fates(PORT, "a", telemetry(cycle)))


ONCE, TWICE = (next(cycle for cycle in range(10) if copies(cycle) == wanted) for wanted in (1, 2))


class Wire:
    """The network before the faults: gives what has come, or lets the time pass."""

    def __init__(self, *coming: Arrival) -> None:
        self.coming = [*coming]
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.now_ns = ClockByHand(0)

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        came, self.coming = self.coming, []
        if not came:
            assert until_ns is not None, "it would wait for ever"
            self.now_ns.now_ns = until_ns
        return came


def faulty_bus(*arrivals: Arrival) -> FaultyBus:
    """An inverter's place on the bus, at the end of imperfect links, to which these come."""
    return FaultyBus(cast(Any, Wire(*arrivals)), "a", FAULTS)


def test_a_delayed_message_arrives_when_it_is_due_and_a_lost_one_never() -> None:
    bus = faulty_bus(*(Arrival("a", PORT, telemetry(cycle), 0) for cycle in (12, ONCE)))
    assert bus.receive(None) == bus.receive(39 * MS) == []
    (arrival,) = bus.receive(1_000 * MS)
    assert (arrival.message.cycle, arrival.time_ns) == (ONCE, 40 * MS + 1_000)
    assert bus.receive(1_000 * MS) == []
    assert +bus.tally == {"lost": 1, "delayed": 1}


def test_a_doubled_message_arrives_twice() -> None:
    bus = faulty_bus(Arrival("a", PORT, telemetry(TWICE), 0))
    # The copy has a delay of its own.
    heard = [arrival for _ in range(3) for arrival in bus.receive(1_000 * MS)]
    assert [arrival.message.cycle for arrival in heard] == [TWICE, TWICE]


def test_a_flood_that_is_under_way_is_bounded_and_counted() -> None:
    hour = NetworkFaults((FaultRule(delay_ms=3_600_000.0),), 1, TREE, 1_000 * MS)
    wire = Wire(*[Arrival("a", PORT, telemetry(1), 0)] * 150_000)
    bus = FaultyBus(cast(Any, wire), "a", hour)
    assert bus.receive(0) == []
    assert wire.dropped == {("a/telemetry", "flooded"): 50_000}
