"""What every bus stamps on the messages that it sends."""

from __future__ import annotations

from bus_schemas.bus import Delivery, Outbox
from bus_schemas.messages import Ready, Residual
from bus_schemas.signals import READY, RESIDUAL
from bus_schemas.tree import ROOT


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
