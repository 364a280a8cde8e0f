"""Delayed, lost and doubled messages at one agent's end of its links."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any, cast

from bus_schemas.bus import Arrival, Outbox
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
    """The network before the faults: gives what has come, or waits in vain."""

    def __init__(self) -> None:
        self.coming: list[Arrival] = []
        self.outbox = Outbox()
        self.now_ns = time.monotonic_ns

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        came, self.coming = self.coming, []
        if not came:
            assert until_ns is not None, "it would wait for ever"
            time.sleep(max(until_ns - time.monotonic_ns(), 0) / 1e9)
        return came


class Inverter:
    """An inverter's place on the bus, at the end of imperfect links."""

    def __init__(self, faults: NetworkFaults = FAULTS) -> None:
        self.wire = Wire()
        self.bus = FaultyBus(cast(Any, self.wire), "a", faults)

    def send(self, *cycles: int) -> int:
        """Let telemetry of cycles come over the wire; return when."""
        now_ns = time.monotonic_ns()
        self.wire.coming += [Arrival("a", PORT, telemetry(cycle), now_ns) for cycle in cycles]
        return now_ns

    def hear(self, within_ms: float) -> list[Arrival]:
        """Return what comes first within a time."""
        until_ns = time.monotonic_ns() + round(within_ms * MS)
        while not (heard := self.bus.receive(until_ns)) and time.monotonic_ns() < until_ns:
            pass
        return heard


def test_a_delayed_message_arrives_when_it_is_due_and_not_before() -> None:
    inverter = Inverter()
    sent_ns = inverter.send(ONCE)
    (arrival,) = inverter.hear(1_000)
    assert arrival.time_ns == sent_ns + 40 * MS + 1_000
    assert time.monotonic_ns() >= arrival.time_ns


def test_a_lost_message_does_not_arrive_and_is_counted() -> None:
    inverter = Inverter()
    inverter.send(12, ONCE)
    assert [arrival.message.cycle for arrival in inverter.hear(1_000)] == [ONCE]
    assert inverter.bus.tally.as_counts() == {"lost": 1, "delayed": 1}


def test_a_doubled_message_arrives_twice() -> None:
    inverter = Inverter()
    inverter.send(TWICE)
    heard = inverter.hear(1_000)
    while len(heard) < 2:  # The copy has a delay of its own.
        heard += inverter.hear(1_000)
    assert [arrival.message.cycle for arrival in heard] == [TWICE, TWICE]


def test_a_flood_that_is_under_way_is_bounded_and_counted() -> None:
    hour = NetworkFaults((FaultRule(delay_ms=3_600_000.0),), 1, TREE, 1_000 * MS)
    inverter = Inverter(hour)
    message, now_ns = telemetry(1), time.monotonic_ns()
    inverter.wire.coming = [Arrival("a", PORT, message, now_ns)] * 150_000
    assert inverter.bus.receive(now_ns) == []
    assert inverter.bus.flooded == Counter({"a/telemetry": 50_000})
