"""Delayed, lost and doubled messages at one agent's end of its links."""

from __future__ import annotations

from types import SimpleNamespace
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


def faulty_bus(count: int, *rules: FaultRule) -> FaultyBus:
    """Return an inverter's bus to which `count` messages come now, and none later."""
    message = Telemetry(1, 0, PLANT, (), power_kw=1.0, alpha=1.0, limit_kw=1.0)
    coming, clock = [Arrival("a", PORT, message, 0)] * count, ClockByHand(0)

    def receive(until_ns: int | None, wanted: int) -> list[Arrival]:
        came = coming.copy()
        coming.clear()
        clock.now_ns = clock.now_ns if came or until_ns is None else until_ns
        return came

    wire = SimpleNamespace(receive=receive, now_ns=clock)
    return FaultyBus(cast(Any, wire), "a", NetworkFaults(rules, 1, TREE, 1_000 * MS))


def test_a_delayed_message_arrives_when_it_is_due_and_a_doubled_one_twice() -> None:
    bus = faulty_bus(1, FaultRule(delay_ms=40.0), FaultRule(duplicate=1.0))
    assert bus.receive(0) == bus.receive(39 * MS) == []
    assert [arrival.time_ns for arrival in bus.receive(1_000 * MS)] == [40 * MS] * 2
