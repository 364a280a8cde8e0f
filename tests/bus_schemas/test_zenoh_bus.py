"""One agent's place on the real bus, with another session that puts what it wants on it."""

from __future__ import annotations

import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

import msgspec
import pytest
import zenoh
from running import REPOSITORY

from bus_schemas.codec import encode, encode_bundle
from bus_schemas.messages import Impp, Message, Ready, Telemetry
from bus_schemas.signals import IMPP, READY, TELEMETRY, Port
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, RECORDER, ROOT, ControlTree
from bus_schemas.wiring import Wiring
from bus_schemas.zenoh_bus import ZenohBus
from bus_schemas.zenoh_session import RunSubscriber, SessionSettings, open_session

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
        while not bus.inbox.dropped:
            bus.receive(time.monotonic_ns() + 20_000_000)
        bus.inbox.dropped.clear()
        yield session, bus


def test_undecodable_messages_are_counted_and_later_ones_heard(
    linked: tuple[zenoh.Session, ZenohBus],
) -> None:
    session, bus = linked
    session.put(KEY, b"\xc1 garbage")
    began_ns = time.monotonic_ns()
    assert bus.receive(began_ns + 300_000_000) == []
    assert time.monotonic_ns() - began_ns >= 300_000_000, "an agent that got nothing says so"
    assert bus.inbox.dropped == {("a/telemetry", "undecodable"): 1}
    for payload in (b"", GOOD):
        session.put(KEY, payload)
    (arrival,) = bus.receive(None)
    assert (arrival.agent, str(arrival.port), arrival.message.cycle) == ("a", "a/telemetry", 0)


def test_a_bundle_that_is_too_large_goes_as_several_and_a_wrong_one_does_not_decode() -> None:
    tree = ControlTree(tuple((f"c1/i{number}", 1.0) for number in range(200)))
    wiring = Wiring("pair", tree, dict.fromkeys(("c1", *tree.leaves), "c1"))
    ports = [TELEMETRY.of(leaf) for leaf in tree.leaves]
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint = [f"tcp/127.0.0.1:{port}"]
        settings = SessionSettings("bus-by-hand", endpoint, [])
        plant = stack.enter_context(ZenohBus(PLANT, wiring, settings, 60))
        settings = SessionSettings("bus-by-hand", [], endpoint)
        group = stack.enter_context(ZenohBus("c1", wiring, settings, 60))
        observer = stack.enter_context(zenoh.open(settings.config()))
        sizes: list[int] = []
        key = "pair/c1/telemetry_bundle"
        observer.declare_subscriber(key, lambda each: sizes.append(len(each.payload.to_bytes())))
        came: list[Port[Message]] = []
        for cycle in range(1_000):
            for one in ports:
                message = Telemetry(cycle, 0, PLANT, (), power_kw=1.0, alpha=1.0, limit_kw=1.0)
                plant.publish(one, message, time.monotonic_ns())
            plant.send_bundles()
            came = []
            while arrivals := group.receive(time.monotonic_ns() + 100_000_000, len(ports)):
                came += [one.port for one in arrivals if one.message.cycle == cycle]
            if came and sizes:  # The first ones may go before the links are up.
                break
        assert came == ports
        assert max(sizes) < 16_384 < sum(sizes)
    (bundle,) = (one for one in wiring.bundles if one.source == PLANT)
    others = encode_bundle([("c1/i0/impp", message)]), encode_bundle([("c2/i0/telemetry", message)])
    for payload in (b"\xc1 garbage", b"\x01", GOOD, *others):
        with pytest.raises(msgspec.DecodeError):
            bundle.messages(payload)


# Links that carry nothing -------------------------------------------------------------------------


class Proxy:
    """Forwards to a port, until it is `cut`: the links that there are stay open, and carry nothing.

    A new link is whole again, as after a host has lost its power.
    """

    def __init__(self, target: int) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._target = target
        self._cuts = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        self._cuts += 1

    def _accept(self) -> None:
        while True:
            near, _ = self._server.accept()
            far = socket.create_connection(("127.0.0.1", self._target))
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(*ends, self._cuts), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, cuts: int) -> None:
        with suppress(OSError):
            while data := source.recv(65_536):
                if self._cuts == cuts:
                    sink.sendall(data)


def test_a_process_that_starts_again_is_heard_beside_the_old_links_of_its_agent() -> None:
    wiring = Wiring("pair", TREE)
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        plant = stack.enter_context(
            open_session(SessionSettings("cut", [f"tcp/127.0.0.1:{port}"], []))
        )
        heard = plant.declare_subscriber(wiring.key(IMPP.of("a")))
        proxy = Proxy(port)
        settings = SessionSettings("cut", [], [proxy.endpoint])
        until_heard(stack.enter_context(ZenohBus("a", wiring, settings, 60)), heard)
        proxy.cut()
        bus = stack.enter_context(ZenohBus("a", wiring, settings, 60))
        while heard.try_recv() is not None:
            pass
        until_heard(bus, heard)
        plant.put(KEY, GOOD)
        assert bus.receive(None), "it hears, too"


def test_a_link_that_carries_nothing_is_closed_after_its_lease_and_opened_anew() -> None:
    wiring = Wiring("pair", TREE)
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        short: dict[str, Any] = {"lockstep": False, "lease_s": 1.0, "open_s": 1.0}
        plant = stack.enter_context(
            open_session(SessionSettings("cut", [f"tcp/127.0.0.1:{port}"], [], **short))
        )
        heard = plant.declare_subscriber(wiring.key(IMPP.of("a")))
        proxy = Proxy(port)
        bus = stack.enter_context(
            ZenohBus("a", wiring, SessionSettings("cut", [], [proxy.endpoint], **short), 60)
        )
        until_heard(bus, heard)
        proxy.cut()
        time.sleep(0.1)
        while heard.try_recv() is not None:
            pass
        until_heard(bus, heard)
        plant.put(KEY, GOOD)
        assert bus.receive(None), "it hears, too"


def test_who_asks_for_the_newest_messages_waits_for_no_silent_answer() -> None:
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        endpoint, asked = [f"tcp/127.0.0.1:{port}"], list[zenoh.Query]()
        plant = stack.enter_context(open_session(SessionSettings("silent", endpoint, [])))
        plant.declare_queryable("pair/**", asked.append)
        settings = SessionSettings("silent", [], endpoint)
        bus = stack.enter_context(ZenohBus("a", Wiring("pair", TREE), settings, 1.0))
        while not asked:
            began_at = time.monotonic()
            assert bus.newest() == []
        assert time.monotonic() - began_at < 3.0
        for query in asked:
            query.drop()


def test_other_sockets_of_the_process_keep_their_lingering() -> None:
    linger, kind = struct.pack("ii", True, 7), (socket.SOL_SOCKET, socket.SO_LINGER)
    with ExitStack() as stack:
        (port,) = stack.enter_context(reserved_ports([PLANT])).values()
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        other = stack.enter_context(socket.create_connection(server.getsockname()))
        other.setsockopt(*kind, linger)
        ours = stack.enter_context(socket.create_server(("127.0.0.1", port)))
        link = stack.enter_context(socket.create_connection(ours.getsockname()))
        link.setsockopt(*kind, linger)
        settings = SessionSettings("linger", [], [f"tcp/127.0.0.1:{port}"], lease_s=0.4)
        stack.enter_context(ZenohBus("a", Wiring("pair", TREE), settings, 1.0))
        while link.getsockopt(*kind, 8) == linger:
            time.sleep(0.05)
        assert other.getsockopt(*kind, 8) == linger


def until_heard(bus: ZenohBus, heard: zenoh.Subscriber[Any]) -> None:
    """Let an inverter's controller speak until it is heard."""
    give_up_at = time.monotonic() + 30.0  # Half of a lease.
    while heard.try_recv() is None:
        assert time.monotonic() < give_up_at
        bus.publish(IMPP.of("a"), Impp(0, 0, "a", (), power_kw=1.0, stale_cycles=0), 0)
        time.sleep(0.02)


LISTEN = """
import sys, zenoh
from bus_schemas.zenoh_session import SessionSettings
session = zenoh.open(SessionSettings("stopped", [], sys.argv[1:2], lockstep=False).config())
count = 0
def hear(sample):
    global count
    count += 1
    if count == int(sys.argv[2]):
        print("all", flush=True)
subscriber = session.declare_subscriber("pair/ready", zenoh.handlers.Callback(hear, indirect=False))
token = session.liveliness().declare_token("pair/plant/alive")
sys.stdin.read()
"""


def test_answers_of_the_recorder_wait_for_a_plant_that_stands_still() -> None:
    number, filler = 400, (("x" * 1000),) * 50  # Together more than the buffers between them.
    wiring = Wiring("pair", TREE)
    with reserved_ports([RECORDER]) as ports:
        endpoint = f"tcp/127.0.0.1:{ports[RECORDER]}"
        settings = SessionSettings("stopped", [endpoint], [], lockstep=False)
        words = [sys.executable, "-c", LISTEN, endpoint, str(number)]
        pipe = subprocess.PIPE
        with (
            RunSubscriber(RECORDER, wiring, settings) as subscriber,
            subprocess.Popen(words, cwd=REPOSITORY, stdin=pipe, stdout=pipe) as plant,
        ):
            tokens = subscriber.watch_tokens()
            while wiring.alive_key(PLANT) not in tokens.alive():
                time.sleep(0.01)
            plant.send_signal(signal.SIGSTOP)
            # Not a thread of ours: a message that waits keeps the interpreter to itself.
            subprocess.Popen(["sh", "-c", f"sleep 1; kill -CONT {plant.pid}"])
            for cycle in range(number):
                subscriber.publish(READY.of(ROOT), Ready(-cycle, 0, RECORDER, filler))
            assert plant.stdout is not None
            assert plant.stdout.readline() == b"all\n"
            plant.kill()


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
