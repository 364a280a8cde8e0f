"""A Zenoh session that publishes recorded bytes for any subscriber that connects."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, Self, TextIO

import zenoh

from agents.plan import RunPlan
from agents.process.interruption import Interruption
from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Clock, Message
from bus_schemas.selection import find_signals
from bus_schemas.signals import CLOCK, Port
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import REPLAYER, ROOT
from bus_schemas.zenoh_session import ENCODING, SessionSettings, open_session
from recordings.read.reader import RunReader


class StatusLine(Protocol):
    """Where the user reads how far a replay has come."""

    def is_due(self) -> bool: ...

    def show(self, text: str) -> None: ...

    def end(self) -> None: ...


@dataclass(frozen=True)
class ReplayOptions:
    """The options of the command. `rate` 0: as fast as possible.

    without: Nodes whose agents are left out. process_module: What runs such an agent by hand.
    """

    start: str | None = None
    end: str | None = None
    rate: float = 1.0
    loop: bool = False
    wait: bool = False
    listen: str | None = None
    without: str | None = None
    process_module: str = ""


class ReplayBus:
    """Publishes payloads as they are. A slow subscriber holds the replay up: nothing is dropped.

    Subscribers connect to the endpoint. The name of the run is the prefix of every key.
    """

    def __init__(self, plan: RunPlan, ports: Iterable[Port[Message]], endpoint: str) -> None:
        try:
            self.session = open_session(SessionSettings(plan.run_id, [endpoint], []))
        except zenoh.ZError as error:
            reason = str(error).partition(" at /")[0]
            raise InputError.of(
                "--listen",
                f"expected a free address such as tcp/127.0.0.1:7447, got {endpoint}: {reason}",
            ) from None
        self._plan = plan
        self._outbox = Outbox()
        self._publishers = {
            port: self.session.declare_publisher(
                plan.wiring.key(port),
                encoding=ENCODING,
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
            )
            for port in ports
        }

    def put(self, port: Port[Message], payload: bytes) -> bool:
        """Publish bytes, if the port is among those that are published; return whether it is."""
        if port not in self._publishers:
            return False
        self._publishers[port].put(payload)
        return True

    def announce(self, cycle: int, *, rate: float) -> None:
        sim_time_ns = self._plan.timing.sim_time_ns(cycle)
        message = Clock(cycle, sim_time_ns, REPLAYER, (), rate=rate)
        self._outbox.stamp(CLOCK.of(ROOT), message, time.monotonic_ns())
        self.put(CLOCK.of(ROOT), encode(message))

    @property
    def has_subscriber(self) -> bool:
        # The type stub says that a status is a bool, which it is not.
        statuses: list[Any] = [one.matching_status for one in self._publishers.values()]
        return any(status.matching for status in statuses)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can block the exit of the interpreter.
        self.session.close()


def selected_ports(
    reader: RunReader, signals: str | None = None, nodes: str | None = None
) -> list[Port[Message]]:
    """Return the ports that are replayed: by default the recorded ones, and the replay's clock."""
    ports = list(reader.ports(*find_signals(signals or ""), nodes=nodes or ""))
    if not ports:
        raise InputError.of("--signals, --nodes", "expected some message, got none")
    return [*ports, CLOCK.of(ROOT)]


@contextmanager
def replay_bus(
    reader: RunReader, ports: Collection[Port[Message]], listen: str | None, out: TextIO
) -> Iterator[ReplayBus]:
    """Join the bus, at an address or at a free port of 127.0.0.1; print how to subscribe."""
    plan = reader.plan
    with reserved_ports((REPLAYER,)) as tcp_ports:
        endpoint = listen or f"tcp/127.0.0.1:{tcp_ports[REPLAYER]}"
        with ReplayBus(plan, ports, endpoint) as bus:
            say(out, f"{plan.run_id}, {reader.clock.extent()}")
            if not reader.whole:
                say(out, "the recording was cut short: replayed up to the cut")
            say(out, f"endpoint {endpoint}\nkeys {plan.run_id}/{plan.plant}/**")
            yield bus


def await_subscriber(bus: ReplayBus, interruption: Interruption, out: TextIO) -> None:
    """Wait until somebody subscribes, or the user asks for an end."""
    say(out, "waiting for a subscriber")
    while not interruption and not bus.has_subscriber:
        interruption.wait(0.05)


def say(out: TextIO, text: str) -> None:
    out.write(f"{text}\n")
    out.flush()
