"""One agent's place on the real bus, with another session that puts what it wants on it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
import zenoh
from running import REPOSITORY

from bus_schemas.codec import encode
from bus_schemas.messages import Telemetry
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, RECORDER, ControlTree
from bus_schemas.wiring import Wiring
from bus_schemas.zenoh_bus import ZenohBus
from bus_schemas.zenoh_session import RunSubscriber, SessionSettings

TREE = ControlTree((("a", 100.0),))
KEY = "pair/a/telemetry"
GOOD = encode(Telemetry(0, 0, PLANT, (), power_kw=1.0, alpha=1.0, limit_kw=1.0))


@pytest.fixture
def linked() -> Iterator[tuple[zenoh.Session, ZenohBus]]:
    """A session that is linked with the place of an inverter, which has heard it already."""
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        settings = SessionSettings("bus-by-hand", endpoint, [])
        session = stack.enter_context(zenoh.open(settings.config()))
        settings = SessionSettings("bus-by-hand", [], endpoint)
        bus = stack.enter_context(ZenohBus("a", Wiring("pair", TREE), settings, 60))
        session.put(KEY, GOOD)
        while not bus.receive(time.monotonic_ns() + 20_000_000):
            session.put(KEY, GOOD)  # The first ones may go before the link is up.
        session.put(KEY, b"last")
        while not bus.dropped:
            bus.receive(time.monotonic_ns() + 20_000_000)
        bus.dropped.clear()
        yield session, bus


def test_what_does_not_decode_is_counted_and_does_not_look_like_silence(
    linked: tuple[zenoh.Session, ZenohBus],
) -> None:
    session, bus = linked
    session.put(KEY, b"\xc1 garbage")
    began_ns = time.monotonic_ns()
    assert bus.receive(began_ns + 300_000_000) == []
    assert time.monotonic_ns() - began_ns >= 300_000_000, "an agent that got nothing says so"
    assert bus.dropped == {("a/telemetry", "undecodable"): 1}


def test_a_message_that_comes_after_it_is_heard(linked: tuple[zenoh.Session, ZenohBus]) -> None:
    session, bus = linked
    for payload in (b"", GOOD):
        session.put(KEY, payload)
    (arrival,) = bus.receive(None)
    assert (arrival.agent, str(arrival.port), arrival.message.cycle) == ("a", "a/telemetry", 0)


FLOOD = f"""
import sys, zenoh
from bus_schemas.zenoh_session import SessionSettings
session = zenoh.open(SessionSettings("flooded", [], sys.argv[1:]).config())
while True:
    session.put("{KEY}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
"""


def test_a_listener_closes_while_more_comes_than_its_queue_takes() -> None:
    with reserved_ports([RECORDER]) as ports:
        endpoint = f"tcp/127.0.0.1:{ports[RECORDER]}"
        settings = SessionSettings("flooded", [endpoint], [])
        with subprocess.Popen([sys.executable, "-c", FLOOD, endpoint], cwd=REPOSITORY) as flooding:
            try:
                with RunSubscriber(RECORDER, Wiring("pair", TREE), settings) as subscriber:
                    while next(subscriber.drain(), None) is None:
                        time.sleep(0.01)
                    time.sleep(1.0)  # Its queue fills.
                    closes_at = time.monotonic()
                assert time.monotonic() - closes_at < 9.0, "after 10 s Zenoh gives up"
            finally:
                flooding.kill()
