"""Delayed, lost and doubled messages: by a clock by hand, and between two sessions of Zenoh."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest
from clock_by_hand import ClockByHand

from bus_schemas.bus import Arrival
from bus_schemas.faults import FaultRule, NetworkFaults
from bus_schemas.faulty_bus import FaultyBus, UnderWay
from bus_schemas.keys import KeyTable
from bus_schemas.messages import Command, Message, Run, Telemetry
from bus_schemas.signals import COMMAND, RUN, SETPOINT, TELEMETRY, Port
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
    assert under_way.flooded == {"a/telemetry": 190_000}
    # Others are heard through it, and what has arrived leaves room.
    under_way.put(arrival(5, SETPOINT.of("a")))
    assert under_way.flooded.total() == 190_000
    assert len(under_way.take_due(9_600)) == 9_602
    under_way.put(arrival(1))
    assert under_way.flooded.total() == 190_000
    assert under_way.next_due_ns == 1


def test_many_keys_are_all_heard_however_many_are_under_way() -> None:
    under_way = UnderWay()
    ports = [TELEMETRY.of(f"a{number}") for number in range(200)]
    for number in range(900):
        for port in ports:
            under_way.put(arrival(number, port))
    assert (len(under_way), under_way.flooded.total()) == (180_000, 0)


def test_a_long_delay_loses_nothing_to_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour at a cycle a second, from each of three inverters: over 10,000 are under way."""
    tree = ControlTree((("a", 1.0), ("b", 1.0), ("c", 1.0)))
    faults = NetworkFaults((FaultRule(delay_ms=3_600_000.0),), 1, tree, 1_000 * MS)
    clock = ClockByHand()
    wire = Wire(clock)
    monkeypatch.setattr(ZenohBus, "receive", lambda bus, *limits: wire.receive(*limits))
    alone = SessionSettings("alone-for-an-hour", [], [], lockstep=False)
    ports = [COMMAND.of(leaf) for leaf in tree.leaves]
    heard: list[Arrival] = []
    began_ns = clock.now_ns
    with FaultyBus(PLANT, KeyTable("long", tree), tree, alone, faults, now_ns=clock) as bus:
        for cycle in range(3_700):
            clock.now_ns = began_ns + cycle * 1_000 * MS
            for port in ports:
                command = Command(cycle, 0, port.node, (), alpha=1.0, power_kw=1.0)
                wire.coming.append(Arrival(port, command, clock.now_ns))
            heard += bus.receive(1, 0.0)
        assert not bus.flooded
    assert [arrival.message.cycle for arrival in heard[::3]] == list(range(100))


def test_what_is_due_comes_in_the_order_of_its_time() -> None:
    under_way = UnderWay()
    for time_ns in (30, 10, 20, 10):
        under_way.put(arrival(time_ns))
    assert [found.time_ns for found in under_way.take_due(25)] == [10, 10, 20]
    assert (len(under_way), under_way.next_due_ns) == (1, 30)


class Wire:
    """The network before the faults: messages that come at times of a clock by hand."""

    def __init__(self, clock: ClockByHand) -> None:
        self.coming: list[Arrival] = []
        self._clock = clock

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        """Wait until so many messages or an urgent one have come, or for the time-out."""
        wakes_ns = [self._clock.now_ns + round(timeout_s * 1e9)] if timeout_s is not None else []
        wakes_ns += [came.time_ns for came in self.coming[wanted - 1 : wanted]] if wanted else []
        wakes_ns += [came.time_ns for came in self.coming if came.port is RUN.of(ROOT)]
        assert wakes_ns, "it would wait for ever"
        self._clock.now_ns = max(self._clock.now_ns, min(wakes_ns))
        heard = [came for came in self.coming if came.time_ns <= self._clock.now_ns]
        self.coming = self.coming[len(heard) :]
        return heard


@dataclass
class Inverter:
    """An inverter's place on the bus, at the end of imperfect links of which all is known."""

    bus: FaultyBus
    wire: Wire
    clock: ClockByHand

    def send(self, *cycles: int, after_ms: float = 0.0) -> None:
        """Let telemetry of cycles come over the wire, from the beginning on."""
        came_ns = BEGAN_NS + round(after_ms * MS)
        self.wire.coming += [Arrival(PORT, telemetry(cycle), came_ns) for cycle in cycles]

    def hear(self, wanted: int, timeout_s: float | None) -> tuple[list[int], float]:
        """Return the cycles that are heard, and when that is, to 0.01 ms [ms]."""
        heard = self.bus.receive(wanted, timeout_s)
        assert all(found.time_ns <= self.clock.now_ns for found in heard)
        now_ms = round((self.clock.now_ns - BEGAN_NS) / MS, 2)
        return [found.message.cycle for found in heard], now_ms


BEGAN_NS = ClockByHand().now_ns


@pytest.fixture
def inverter(monkeypatch: pytest.MonkeyPatch) -> Iterator[Inverter]:
    clock = ClockByHand()
    wire = Wire(clock)
    monkeypatch.setattr(ZenohBus, "receive", lambda bus, *limits: wire.receive(*limits))
    alone = SessionSettings("alone-by-hand", [], [], lockstep=False)
    with FaultyBus("a", KEYS, TREE, alone, FAULTS, now_ns=clock) as bus:
        yield Inverter(bus, wire, clock)


def test_a_delayed_message_arrives_when_it_is_due_and_not_before(inverter: Inverter) -> None:
    inverter.send(ONCE, after_ms=1.0)
    assert inverter.hear(1, 0.05) == ([], 50.0)
    assert inverter.hear(1, 5.0) == ([ONCE], 151.0)


def test_a_lost_message_does_not_arrive_and_the_agent_waits_for_its_deadline(
    inverter: Inverter,
) -> None:
    inverter.send(12, after_ms=1.0)
    assert inverter.hear(1, 0.3) == ([], 300.0)
    assert inverter.bus.tally.lost == 1


def test_it_waits_for_as_many_as_are_wanted(inverter: Inverter) -> None:
    for after_ms, cycle in ((1.0, ONCE), (2.0, 12), (3.0, ONCE), (40.0, ONCE)):
        inverter.send(cycle, after_ms=after_ms)
    assert inverter.hear(3, None) == ([ONCE] * 3, 190.0)


def test_without_a_time_to_wait_it_returns_what_is_due(inverter: Inverter) -> None:
    inverter.send(ONCE)
    assert inverter.hear(1, 0.0) == ([], 0.0)
    inverter.clock.sleep(0.149)
    assert inverter.hear(1, 0.0) == ([], 149.0)
    inverter.clock.sleep(0.002)
    assert inverter.hear(1, 0.0) == ([ONCE], 151.0)


def test_a_rare_event_wakes_the_agent_at_once_and_is_not_delayed(inverter: Inverter) -> None:
    inverter.send(12, after_ms=1.0)
    start = Run(0, 0, PLANT, (), state="start", start_time_ns=0, cycle_wall_ns=1)
    inverter.wire.coming.append(Arrival(RUN.of(ROOT), start, BEGAN_NS + 7 * MS))
    assert inverter.hear(1000, 60.0) == ([0], 7.0)


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

    def hear(self, wanted: int) -> list[Arrival]:
        """Wait for messages for as long as it takes."""
        return self.inverter.receive(wanted, None)


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    """The two, linked, with nothing under way."""
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        of_plant = SessionSettings("pair-by-hand", endpoint, [], lockstep=False)
        plant = stack.enter_context(ZenohBus(PLANT, KEYS, TREE, of_plant))
        of_inverter = SessionSettings("pair-by-hand", [], endpoint, lockstep=False)
        inverter = stack.enter_context(FaultyBus("a", KEYS, TREE, of_inverter, FAULTS))
        pair = Pair(plant, inverter)
        # An arming round passes as soon as the link is up, and each in its order.
        first = -1
        while not (heard := inverter.receive(1, 0.02)):
            first -= 1
            pair.send(first)
        while heard[-1].message.cycle != first:
            heard = pair.hear(1)
        yield pair


def test_over_zenoh_a_delayed_message_arrives_when_it_is_due(pair: Pair) -> None:
    sent_ns = pair.send(ONCE)
    (arrival,) = pair.hear(1)
    assert arrival.message.cycle == ONCE
    assert sent_ns + 150 * MS <= arrival.time_ns <= time.monotonic_ns()


def test_over_zenoh_lost_messages_do_not_keep_it_from_what_comes_after_them(pair: Pair) -> None:
    lost_before = pair.inverter.tally.lost
    pair.send(11, 12, 13, ONCE)
    (arrival,) = pair.hear(1)
    assert arrival.message.cycle == ONCE
    assert pair.inverter.tally.lost == lost_before + 3


def test_over_zenoh_a_doubled_message_arrives_twice(pair: Pair) -> None:
    pair.send(TWICE)
    heard: list[Arrival] = []
    while len(heard) < 2:  # The copy has a delay of its own.
        heard += pair.hear(1)
    assert [arrival.message.cycle for arrival in heard] == [TWICE, TWICE]


def test_over_zenoh_a_rare_event_wakes_the_agent_at_once(pair: Pair) -> None:
    start = Run(0, 0, PLANT, (), state="start", start_time_ns=0, cycle_wall_ns=1)
    pair.plant.publish(RUN.of(ROOT), start)
    # Without a time-out: if it were not urgent, this would wait for ever.
    assert [arrival.port for arrival in pair.hear(1000)] == [RUN.of(ROOT)]
