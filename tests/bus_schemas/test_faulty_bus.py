"""Delayed, lost and doubled messages between two sessions on the loopback address."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from bus_schemas.bus import Arrival
from bus_schemas.faults import FaultRule, NetworkFaults
from bus_schemas.faulty_bus import FaultyBus, UnderWay
from bus_schemas.keys import KeyTable
from bus_schemas.messages import Message, Run, Telemetry
from bus_schemas.signals import RUN, SETPOINT, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, ControlTree
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus
from launch_scripts.tcp_ports import reserved_ports

TREE = ControlTree((("a", 100.0), ("b", 100.0)))
KEYS = KeyTable("pair", TREE)
PORT = TELEMETRY.of("a")
RULES = (
    FaultRule(delay_ms=150.0),
    FaultRule(silent=((10.0, 20.0),)),
    FaultRule(reorder=1.0, reorder_ms=0.001, duplicate=0.5),
)
"""Cycles are seconds here: nothing of the cycles 10 to 19 arrives."""

MS = 1_000_000
FAULTS = NetworkFaults(RULES, 1, TREE, 1_000 * MS)


def telemetry(cycle: int) -> Telemetry:
    return Telemetry(cycle, 0, PLANT, (), power_kw=1.0, alpha=1.0, limit_kw=1.0)


def copies(cycle: int) -> int:
    return len(FAULTS.fates(PORT, "a", telemetry(cycle)))


ONCE, TWICE = (next(cycle for cycle in range(10) if copies(cycle) == wanted) for wanted in (1, 2))


def arrival(time_ns: int, port: Port[Message] = PORT) -> Arrival:
    return Arrival(port, telemetry(0), time_ns)


def test_a_flood_that_is_under_way_is_bounded_and_counted() -> None:
    under_way = UnderWay()
    for number in range(200_000):
        under_way.put(arrival(number))
    assert len(under_way) == 10_000
    assert under_way.flooded == 190_000
    # Others are heard through it, and what has arrived leaves room.
    under_way.put(arrival(5, SETPOINT.of("a")))
    assert under_way.flooded == 190_000
    assert len(under_way.take_due(9_600)) == 9_602
    under_way.put(arrival(1))
    assert under_way.flooded == 190_000
    assert under_way.next_due_ns == 1


def test_many_keys_are_all_heard_however_many_are_under_way() -> None:
    under_way = UnderWay()
    ports = [TELEMETRY.of(f"a{number}") for number in range(200)]
    for number in range(900):
        for port in ports:
            under_way.put(arrival(number, port))
    assert (len(under_way), under_way.flooded) == (180_000, 0)


def test_what_is_due_comes_in_the_order_of_its_time() -> None:
    under_way = UnderWay()
    for time_ns in (30, 10, 20, 10):
        under_way.put(arrival(time_ns))
    assert [found.time_ns for found in under_way.take_due(25)] == [10, 10, 20]
    assert (len(under_way), under_way.next_due_ns) == (1, 30)


class Pair:
    """The plant's place on the bus, and that of an inverter at the end of imperfect links."""

    def __init__(self, plant: ZenohBus, inverter: FaultyBus) -> None:
        self.plant = plant
        self.inverter = inverter

    def send(self, *cycles: int) -> int:
        """Send telemetry of cycles; return when [ns]."""
        sent_ns = time.monotonic_ns()
        for cycle in cycles:
            self.plant.publish(PORT, telemetry(cycle))
        return sent_ns

    def hear(self, wanted: int, timeout_s: float) -> list[Arrival]:
        return self.inverter.receive(wanted, timeout_s)


@pytest.fixture(scope="module")
def linked() -> Iterator[Pair]:
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        of_plant = SessionSettings("pair-by-hand", endpoint, [], lockstep=False)
        plant = stack.enter_context(ZenohBus(PLANT, KEYS, TREE, of_plant))
        of_inverter = SessionSettings("pair-by-hand", [], endpoint, lockstep=False)
        inverter = stack.enter_context(FaultyBus("a", KEYS, TREE, of_inverter, FAULTS))
        pair = Pair(plant, inverter)
        while not pair.hear(1, 0.02):  # An arming round passes as soon as the link is up.
            pair.send(-1)
        yield pair


@pytest.fixture
def pair(linked: Pair) -> Pair:
    """The two, with nothing under way."""
    while linked.hear(1, 0.2):
        pass
    return linked


def test_a_delayed_message_arrives_when_it_is_due_and_not_before(pair: Pair) -> None:
    sent_ns = pair.send(ONCE)
    assert pair.hear(1, 0.05) == []
    (arrival,) = pair.hear(1, 5.0)
    assert arrival.message.cycle == ONCE
    assert arrival.time_ns >= sent_ns + 150 * MS
    assert time.monotonic_ns() >= arrival.time_ns


def test_a_lost_message_does_not_arrive_and_the_agent_waits_for_its_deadline(pair: Pair) -> None:
    lost_before = pair.inverter.tally.lost
    began_ns = pair.send(12)
    assert pair.hear(1, 0.3) == []
    assert time.monotonic_ns() >= began_ns + 300 * MS
    assert pair.inverter.tally.lost == lost_before + 1


def test_lost_messages_do_not_keep_it_from_what_comes_beside_them(pair: Pair) -> None:
    pair.send(11, 12, 13, ONCE)
    (arrival,) = pair.hear(1, 5.0)
    assert arrival.message.cycle == ONCE


def test_a_doubled_message_arrives_twice(pair: Pair) -> None:
    pair.send(TWICE)
    assert [arrival.message.cycle for arrival in pair.hear(1, 5.0)] == [TWICE, TWICE]


def test_a_rare_event_wakes_the_agent_at_once(pair: Pair) -> None:
    start = Run(0, 0, PLANT, (), state="start", start_time_ns=0, cycle_wall_ns=1)
    pair.send(12)
    pair.plant.publish(RUN.of(ROOT), start)
    heard = pair.hear(1000, 60.0)
    assert [arrival.port for arrival in heard] == [RUN.of(ROOT)]


def test_it_waits_for_as_many_as_are_wanted(pair: Pair) -> None:
    pair.send(ONCE, 12, ONCE, ONCE)
    assert len(pair.hear(3, 5.0)) == 3


def test_without_a_time_to_wait_it_returns_what_is_due(pair: Pair) -> None:
    pair.send(ONCE)
    assert pair.hear(1, 0.0) == []
    time.sleep(0.4)
    assert len(pair.hear(1, 0.0)) == 1
