"""The agents around a device, played by one process: a session for each that it is linked with."""

from __future__ import annotations

import time
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import NamedTuple

import zenoh

from agents.plan import RunPlan
from agents.process.session import session_settings
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import RECORDER
from bus_schemas.zenoh_session import ENCODING, open_session


class Heard(NamedTuple):
    """A payload of the device's, and which neighbour heard it."""

    listener: str
    key: str
    payload: bytes
    time_ns: int


class Neighbours:
    """All agents that a device is linked with, on the bus until the context is left."""

    def __init__(self, plan: RunPlan, agent: str) -> None:
        self._plan = plan
        self._agent = agent
        self._kept: list[object] = []
        self._arrived: SimpleQueue[Heard] = SimpleQueue()
        self._seen_by: set[str] = set()
        self._sessions = {name: self._join(name) for name in plan.links.peers(agent)}

    def __enter__(self) -> Neighbours:
        return self

    def __exit__(self, *error: object) -> None:
        for session in self._sessions.values():
            session.close()

    def _join(self, name: str) -> zenoh.Session:
        """Put a neighbour on the bus: it is linked with the device alone."""
        plan, keys, agent = self._plan, self._plan.wiring, self._agent
        settings = session_settings(plan, name).devices
        assert settings is not None  # The plan has no keys, and the device is external.
        of_device, _ = plan.links.endpoints(agent, plan.access.tcp_ports)
        connect = [endpoint for endpoint in settings.connect if endpoint in of_device]
        session = open_session(replace(settings, connect=connect))
        heard = [f"{keys.plant}/**"]
        if name != RECORDER:
            ports = plan.wiring.heard.get(name, ())
            heard = [keys.key(port) for port in ports if port.publisher == agent]

        def hear(sample: zenoh.Sample) -> None:
            key, payload = str(sample.key_expr), sample.payload.to_bytes()
            self._arrived.put(Heard(name, key, payload, time.monotonic_ns()))

        def watch(sample: zenoh.Sample) -> None:
            is_there = sample.kind == zenoh.SampleKind.PUT
            (self._seen_by.add if is_there else self._seen_by.discard)(name)

        self._kept += [session.declare_subscriber(key, hear) for key in heard]
        liveliness = session.liveliness()
        self._kept += [
            liveliness.declare_subscriber(keys.alive_key(agent), watch, history=True),
            liveliness.declare_token(keys.alive_key(name)),
        ]
        return session

    @property
    def absent(self) -> list[str]:
        """Neighbours that do not see the device's token."""
        return [name for name in self._sessions if name not in self._seen_by]

    def put(self, port: Port[Message], payload: bytes) -> None:
        """Send a payload to the device, as the publisher of a port."""
        self._sessions[port.publisher].put(
            self._plan.wiring.key(port),
            payload,
            encoding=ENCODING,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def next(self, timeout_s: float) -> Heard | None:
        """Return the next payload that the device has published; None if none comes in time."""
        try:
            return self._arrived.get(timeout=max(timeout_s, 0.0))
        except Empty:
            return None
