"""An agent's place on the bus between processes."""

from __future__ import annotations

import threading
from typing import Any

from bus_schemas.codec import encode
from bus_schemas.keys import KeyTable
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP, Wiring
from bus_schemas.tree import ControlTree
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus, open_session
from launch_scripts.tcp_ports import reserved_ports

TREE = ControlTree((("c1/a", 100.0),))
PORT = IMPP.of("c1/a")


def test_what_cannot_be_read_does_not_end_a_wait() -> None:
    keys = KeyTable("oahu", TREE)
    message = Impp(3, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)
    with reserved_ports(("c1",)) as tcp_ports:
        endpoint = f"tcp/127.0.0.1:{tcp_ports['c1']}"
        settings = SessionSettings("test", [endpoint], [])
        with (
            ZenohBus("c1", keys, Wiring(TREE), settings, patience_s=30.0) as bus,
            open_session(SessionSettings("test", [], [endpoint])) as device,
        ):
            publisher: Any = device.declare_publisher(keys.key(PORT))
            until = threading.Event()
            while not publisher.matching_status.matching:
                until.wait(0.01)
            publisher.put(b"no message")
            later = threading.Timer(0.2, lambda: publisher.put(encode(message)))
            later.start()
            (arrival,) = bus.receive(None)
            later.join()
    assert (arrival.port, arrival.message) == (PORT, message)
    assert bus.undecodable == {"c1/a/impp": 1}
