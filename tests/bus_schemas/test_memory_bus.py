"""The bus inside one process: stamped messages, in the order they were sent."""

from __future__ import annotations

import time

from bus_schemas.bus import Delivery, Outbox
from bus_schemas.memory_bus import MemoryBus
from bus_schemas.messages import Message, Production, Ready, Request, Residual, Run
from bus_schemas.signals import PRODUCTION, READY, REQUEST, RESIDUAL, RUN, Port
from bus_schemas.tree import ROOT, ControlTree

TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0)))


def residual(node: str, cycle: int) -> Delivery:
    return RESIDUAL.of(node), Residual(cycle, 0, node, (), power_kw=float(cycle))


def request(node: str, cycle: int) -> Delivery:
    return REQUEST.of(node), Request(cycle, 0, "central", (), power_kw=1.0)


def waiting(bus: MemoryBus) -> list[tuple[str, str, int]]:
    """Who gets what of which cycle, in order."""
    found = []
    while (delivery := bus.next()) is not None:
        agent, port, message = delivery
        found.append((agent, str(port), message.cycle))
    return found


def test_messages_arrive_in_the_order_they_were_sent_whoever_gets_them() -> None:
    bus = MemoryBus(TREE)
    for delivery in (residual("c1/b", 0), request("c1", 0), residual("c1/a", 0), request("c1", 1)):
        bus.publish(*delivery)
    assert waiting(bus) == [
        ("c1", "c1/b/residual", 0),
        ("c1", "c1/request", 0),
        ("c1", "c1/a/residual", 0),
        ("c1", "c1/request", 1),
    ]


def test_an_empty_bus_has_nothing_next() -> None:
    assert MemoryBus(TREE).next() is None


def test_a_message_for_all_is_delivered_to_each_but_its_sender() -> None:
    bus = MemoryBus(TREE)
    run = Run(0, 0, "plant", (), state="start", start_time_ns=0, cycle_wall_ns=0)
    bus.publish(RUN.of(ROOT), run)
    assert [agent for agent, _, _ in waiting(bus)] == ["recorder", "central", "c1", "c1/a", "c1/b"]


def test_what_nobody_acts_on_is_still_heard_by_the_recorders_tap() -> None:
    heard: list[tuple[Port[Message], Message]] = []
    bus = MemoryBus(TREE, lambda port, message: heard.append((port, message)))
    production = Production(
        0,
        0,
        "plant",
        (),
        desired_kw=1.0,
        possible_kw=1.0,
        delivered_kw=1.0,
        inverter_mpp_kw=(1.0,),
        inverter_power_kw=(1.0,),
    )
    bus.publish(PRODUCTION.of(ROOT), production)
    assert bus.next() is None
    assert [str(port) for port, _ in heard] == ["production"]


def test_the_tap_hears_what_is_delivered() -> None:
    heard: list[Message] = []
    bus = MemoryBus(TREE, lambda port, message: heard.append(message))
    bus.publish(*residual("c1/a", 3))
    delivery = bus.next()
    assert delivery is not None
    assert delivery[2] is heard[0]


def test_messages_are_numbered_on_each_key_and_stamped_with_the_time() -> None:
    outbox = Outbox()
    before_ns = time.monotonic_ns()
    stamped = [
        outbox.stamp(*delivery)
        for delivery in (residual("c1/a", 0), residual("c1/a", 1), residual("c1/b", 1))
    ]
    assert [message.sequence for message in stamped] == [0, 1, 0]
    times_ns = [before_ns, *(message.publish_time_ns for message in stamped)]
    assert times_ns == sorted(times_ns)
    assert times_ns[-1] <= time.monotonic_ns()


def test_arming_rounds_are_stamped_but_not_numbered() -> None:
    outbox = Outbox()
    before_ns = time.monotonic_ns()
    stamped = [outbox.stamp(*residual("c1/a", cycle)) for cycle in (-8, -7, 0, 1)]
    assert [message.sequence for message in stamped] == [0, 0, 0, 1]
    assert stamped[0].publish_time_ns >= before_ns


def test_a_stamp_changes_nothing_else() -> None:
    port, message = residual("c1/a", 7)
    stamped = Outbox().stamp(port, message)
    assert stamped == Residual(
        7, 0, "c1/a", (), publish_time_ns=stamped.publish_time_ns, sequence=0, power_kw=7.0
    )


def test_what_a_recording_must_hold_is_counted_and_nothing_else() -> None:
    bus = MemoryBus(TREE)
    bus.publish(*residual("c1/a", -1))  # an arming round
    bus.publish(*residual("c1/a", 0))
    bus.publish(*residual("c1/b", 1))
    bus.publish(*request("c1", 0))
    bus.publish(READY.of(ROOT), Ready(0, 0, "recorder", ()))  # a signal that is not logged
    assert bus.published == {"residual": 2, "request": 1}
