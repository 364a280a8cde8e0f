"""A Zenoh session that publishes recorded bytes for any subscriber that connects."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Self

import zenoh

from agents.plan import RunPlan
from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Clock, Message
from bus_schemas.signals import CLOCK, Port
from bus_schemas.tree import REPLAYER, ROOT
from bus_schemas.zenoh_bus import ENCODING, SessionSettings, open_session


class ReplayBus:
    """Publishes payloads as they are. A slow subscriber holds the replay up: nothing is dropped.

    Subscribers connect to the endpoint. The name of the run is the prefix of every key.
    """

    def __init__(self, plan: RunPlan, ports: Iterable[Port[Message]], endpoint: str) -> None:
        try:
            self.session = open_session(SessionSettings(plan.run_id, [endpoint], []))
        except zenoh.ZError as error:
            reason = str(error).partition(" at /")[0]
            raise InputError(
                f"--listen: expected a free address such as tcp/127.0.0.1:7447, got {endpoint}: "
                f"{reason}"
            ) from None
        self._plan = plan
        self._outbox = Outbox()
        self._publishers = {
            port: self.session.declare_publisher(
                plan.keys.key(port),
                encoding=ENCODING,
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
            )
            for port in ports
        }

    def put(self, port: Port[Message], payload: bytes) -> None:
        """Publish bytes, if the port is among those that are published."""
        publisher = self._publishers.get(port)
        if publisher is not None:
            publisher.put(payload)

    def announce(self, cycle: int, *, rate: float, paused: bool) -> None:
        """Publish where the replay stands."""
        sim_time_ns = self._plan.sim_time_ns(cycle)
        message = Clock(cycle, sim_time_ns, REPLAYER, (), rate=rate, paused=paused)
        self._outbox.stamp(CLOCK.of(ROOT), message, time.monotonic_ns())
        self.put(CLOCK.of(ROOT), encode(message))

    @property
    def has_subscriber(self) -> bool:
        """Whether anybody subscribes to any of the keys."""
        return any(_has_match(publisher) for publisher in self._publishers.values())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can block the exit of the interpreter.
        self.session.close()


def _has_match(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # Its type stub says bool, which it is not.
    return bool(status.matching)
