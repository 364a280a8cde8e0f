"""How an agent's sessions join the bus, and the subscriber that hears every message of a run."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import zenoh

from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from bus_schemas.messages import LARGEST_PAYLOAD, Message
from bus_schemas.signals import Port
from bus_schemas.wiring import Wiring

ENCODING: Final = "application/msgpack"

ZENOH_RUNTIME: Final = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), "
    "app: (worker_threads: 1))"
)
"""One worker thread for all of Zenoh's work: see docs/decisions/0003-zenoh-tuning.md."""

QUEUE_LENGTH: Final = 24_576
"""Messages, or tokens, that wait in a queue of Zenoh's own."""

SUBSCRIBER_BATCH_BYTES: Final = 16_384
"""A message that waits keeps the buffer in memory that its batch came in, here some 21 kB: a full
queue takes 512 MB. With Zenoh's own 64 kB it was 48 kB. The 16 batches of a link's queue still hold
what a plant of 1,000 inverters sends at once."""

_MOST_LINKS: Final = 10_000

_LEASE_MS: Final = 60_000
"""How long nothing may come over a link [ms]. A process that ends closes its links at once; one
that is frozen for less keeps them. Among 1,000 inverters a short lease costs a processor."""


@dataclass(frozen=True)
class KeyFiles:
    """Files of an agent's certificate and key, and of its plant's certificate authority."""

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def of(cls, folder: Path, agent: str) -> KeyFiles:
        name = agent.replace("/", ".")
        return cls(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")

    def config(self) -> dict[str, object]:
        """Return Zenoh's settings for links of TLS on which both ends show their certificate."""
        return {
            "transport/link/protocols": ["tls"],
            "transport/link/tls": {
                "root_ca_certificate": str(self.authority),
                "listen_certificate": str(self.certificate),
                "listen_private_key": str(self.key),
                "connect_certificate": str(self.certificate),
                "connect_private_key": str(self.key),
                "enable_mtls": True,
                "verify_name_on_connect": True,
                "close_link_on_expiration": True,
            },
        }


@dataclass(frozen=True)
class SessionSettings:
    """How an agent's session joins the others.

    namespace: Prefix of every key of the run.
    listen, connect: Endpoints, for instance `tcp/127.0.0.1:7447`.
    lockstep: Whether a publisher waits for a listener that falls behind. In real time a message
        that cannot go out within 20 ms is dropped instead.
    further: Further settings, by Zenoh's own names.
    peers: Agents at the other ends of its links.
    devices: Of the agent's second session, for devices, which have no password; None: no devices.
    """

    namespace: str
    listen: list[str]
    connect: list[str]
    lockstep: bool = True
    further: dict[str, object] = field(default_factory=dict)
    peers: tuple[str, ...] = ()
    devices: SessionSettings | None = None

    def config(self) -> zenoh.Config:
        config = zenoh.Config()
        settings: dict[str, object] = {
            "mode": "peer",
            "namespace": self.namespace,
            "listen/endpoints": self.listen,
            "connect/endpoints": self.connect,
            # The others may come up later: try for as long as the launcher lets us live.
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "connect/retry": {
                "period_init_ms": 20,
                "period_max_ms": 200,
                "period_increase_factor": 1.5,
            },
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
            # By default 1,000 and 100: plant and recorder are linked with everybody.
            "transport/unicast/max_sessions": _MOST_LINKS,
            "transport/unicast/accept_pending": _MOST_LINKS,
            # By default 10 s. Plant and recorder open 1,000 links one after the other; one that
            # was given up half open would look whole to the other end, and carry nothing.
            "transport/unicast/accept_timeout": _LEASE_MS,
            "transport/unicast/open_timeout": _LEASE_MS,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 20000,
            # A plant of 1,000 inverters puts 200 kB at once on its link to the recorder.
            "transport/link/tx/queue/size/data": 16,
            "transport/link/tx/lease": _LEASE_MS,
            "transport/link/rx/max_message_size": LARGEST_PAYLOAD,
            "transport/link/protocols": ["tcp"],
        }
        if self.lockstep:
            # By default a listener who stands still for 5 s is cut off, and lacks what is sent.
            settings["transport/link/tx/queue/congestion_control/block/wait_before_close"] = (
                _LEASE_MS * 1000
            )
        for key, value in (settings | self.further).items():
            config.insert_json5(key, json.dumps(value))
        return config


def open_session(settings: SessionSettings) -> zenoh.Session:
    os.environ.setdefault("ZENOH_RUNTIME", ZENOH_RUNTIME)
    return zenoh.open(settings.config())


def open_sessions(settings: SessionSettings) -> list[zenoh.Session]:
    """Open an agent's session, and then that with devices if it has one."""
    return [open_session(each) for each in (settings, settings.devices) if each is not None]


class TokenWatch:
    """The liveliness tokens of all agents, as an agent's sessions see them."""

    def __init__(self, sessions: Sequence[zenoh.Session], wiring: Wiring) -> None:
        self._alive: set[str] = set()
        self._subscribers = [
            session.liveliness().declare_subscriber(
                wiring.alive_key("**"), zenoh.handlers.FifoChannel(QUEUE_LENGTH), history=True
            )
            for session in sessions
        ]

    def changes(self) -> Iterator[tuple[str, bool]]:
        """Yield the key of each token that has appeared (True) or disappeared (False)."""
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                yield str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT

    def alive(self) -> set[str]:
        for key, is_there in self.changes():
            (self._alive.add if is_there else self._alive.discard)(key)
        return self._alive


class AgentSessions:
    """An agent's sessions, open until the context is left."""

    def __init__(self, wiring: Wiring, settings: SessionSettings) -> None:
        self.outbox = Outbox()
        self._wiring = wiring
        self._sessions = open_sessions(settings)
        # A subscriber, queryable or token ends with the last reference to it.
        self._declared: list[object] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Close the sessions: an open one can hang the interpreter's exit."""
        for session in self._sessions:
            # With 1,000 links on a busy machine this takes longer than Zenoh waits. Every message
            # is already out.
            with suppress(zenoh.ZError):
                session.close()

    def watch_tokens(self) -> TokenWatch:
        return TokenWatch(self._sessions, self._wiring)

    def _show_token(self, process: str) -> None:
        """Let others see that the process is there."""
        key = self._wiring.alive_key(process)
        self._declared += (session.liveliness().declare_token(key) for session in self._sessions)


class RunSubscriber(AgentSessions):
    """Hears every message of a run, and can answer.

    Messages wait in a queue of Zenoh's own, without any Python in between, until they are drained.
    When it is full, publishers wait or drop, see `SessionSettings.lockstep`.
    """

    def __init__(self, agent: str, wiring: Wiring, settings: SessionSettings) -> None:
        super().__init__(wiring, settings)
        self._subscribers = [
            session.declare_subscriber(
                f"{wiring.plant}/**",
                zenoh.handlers.FifoChannel(QUEUE_LENGTH),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for session in self._sessions
        ]
        self._show_token(agent)

    def __exit__(self, *error: object) -> None:
        # A session does not close while Zenoh's thread waits for room in a queue.
        closing = threading.Thread(target=super().__exit__, args=error)
        closing.start()
        while closing.is_alive():
            for subscriber in self._subscribers:
                with suppress(zenoh.ZError):  # Its session has closed.
                    while subscriber.try_recv() is not None:
                        pass
            closing.join(0.01)

    def publish(self, port: Port[Message], message: Message) -> None:
        self.outbox.stamp(port, message, time.monotonic_ns())
        for session in self._sessions:
            session.put(self._wiring.key(port), encode(message), encoding=ENCODING)

    def drain(self) -> Iterator[tuple[str, bytes]]:
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                yield str(sample.key_expr), sample.payload.to_bytes()
