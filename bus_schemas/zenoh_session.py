"""How an agent's sessions join the bus, and the subscriber that hears every message of a run."""

from __future__ import annotations

import json
import logging
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import zenoh

from bus_schemas.bus import Outbox
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.wiring import Wiring

log = logging.getLogger(__name__)

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
_LARGEST_BYTES: Final = 1 << 20

LONGEST_LEASE_S: Final = 60.0

SOCKET: Final = "unixsock-stream"
"""Zenoh's protocol for sockets of this host. A path has 107 characters at most."""


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
        """Return Zenoh's settings for TLS on which both ends show their certificate."""
        return {
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
        that cannot go out within `wait_s` is dropped instead.
    lease_s: How long nothing may come over a link before both ends close it.
    open_s: How long a link may take to open. After that, the end that connects tries anew.
    wait_s: How long a message waits for room in the queue of a link. Once one was dropped, others
        are dropped at once until there is room.
    further: Further settings, by Zenoh's own names.
    peers: Agents at the other ends of its links.
    devices: Of the agent's second session, for devices; None: no devices.
    """

    namespace: str
    listen: list[str]
    connect: list[str]
    lockstep: bool = True
    lease_s: float = LONGEST_LEASE_S
    open_s: float = LONGEST_LEASE_S
    wait_s: float = 0.02
    further: dict[str, object] = field(default_factory=dict)
    peers: tuple[str, ...] = ()
    devices: SessionSettings | None = None

    @property
    def tcp_ports(self) -> Set[int]:
        own = {
            int(end.rpartition(":")[2])
            for end in (*self.listen, *self.connect)
            if not end.startswith(SOCKET)
        }
        return own if self.devices is None else own | self.devices.tcp_ports

    def config(self) -> zenoh.Config:
        config = zenoh.Config()
        lease_ms, ends = round(self.lease_s * 1e3), (*self.listen, *self.connect)
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
            # The end that connects gives up first. A link that the other end gave up half open
            # would look whole, and carry nothing.
            "transport/unicast/open_timeout": round(self.open_s * 1e3),
            "transport/unicast/accept_timeout": lease_ms,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": round(
                self.wait_s * 1e6
            ),
            # A plant of 1,000 inverters puts 200 kB at once on its link to the recorder.
            "transport/link/tx/queue/size/data": 16,
            "transport/link/tx/lease": lease_ms,
            "transport/link/rx/max_message_size": _LARGEST_BYTES,
            "transport/link/protocols": sorted({end.partition("/")[0] for end in ends}) or ["tcp"],
        }
        if self.lockstep:
            # By default a listener that stands still for 5 s is cut off, and messages are lost.
            settings["transport/link/tx/queue/congestion_control/block/wait_before_close"] = (
                lease_ms * 1000
            )
        for key, value in (settings | self.further).items():
            config.insert_json5(key, json.dumps(value))
        return config


def open_session(settings: SessionSettings) -> zenoh.Session:
    os.environ.setdefault("ZENOH_RUNTIME", ZENOH_RUNTIME)
    return zenoh.open(settings.config())


def _links(ports: Set[int]) -> Iterator[socket.socket]:
    """Yield a copy of each TCP link of this process that has one of some ports at either end."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # Closed in the meantime, or not connected.
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as link:
                if link.family == socket.AF_UNIX or link.type != socket.SOCK_STREAM:
                    continue
                if not ports.isdisjoint((link.getsockname()[1], link.getpeername()[1])):
                    yield link


def _keep_from_lingering(ports: Set[int], is_over: threading.Event, every_s: float) -> None:
    """See again and again that no link blocks Zenoh's only thread for 10 s when it closes.

    Zenoh sets SO_LINGER to 10 s: one peer that does not acknowledge would silence all others.
    """
    while not is_over.wait(every_s):
        for link in _links(ports):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", False, 0))


class TokenWatch:
    """The liveliness tokens of all processes."""

    def __init__(self, key: str, sessions: Sequence[zenoh.Session]) -> None:
        self._alive: set[str] = set()
        self._subscribers = [
            session.liveliness().declare_subscriber(
                key, zenoh.handlers.FifoChannel(QUEUE_LENGTH), history=True
            )
            for session in sessions
        ]

    def changes(self) -> Iterator[tuple[str, bool]]:
        """Yield the key of each token that has appeared (True) or disappeared (False)."""
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                key, is_there = str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT
                if is_there != (key in self._alive):
                    self._alive ^= {key}
                    yield key, is_there

    def alive(self) -> set[str]:
        for _ in self.changes():
            pass
        return self._alive


class Sessions:
    """The sessions of a process, open until the context is left: its own, and one with devices.

    all: The sessions; that with devices comes second, if there is one.
    kept: Subscribers, queryables and tokens: each ends with the last reference to it.
    """

    def __init__(self, wiring: Wiring, settings: SessionSettings) -> None:
        self.all = [open_session(settings)]
        self.kept: list[object] = []
        self._wiring = wiring
        self._is_over = threading.Event()
        if settings.devices is not None:
            try:
                self.all.append(open_session(settings.devices))
            except zenoh.ZError:
                self.close()
                raise
        if ports := settings.tcp_ports:
            words = ports, self._is_over, settings.lease_s / 4.0
            threading.Thread(target=_keep_from_lingering, args=words, daemon=True).start()

    def watch_tokens(self) -> TokenWatch:
        return TokenWatch(self._wiring.alive_key("**"), self.all)

    def show_token(self, process: str) -> None:
        key = self._wiring.alive_key(process)
        self.kept += (session.liveliness().declare_token(key) for session in self.all)

    def close(self) -> None:
        """Close the sessions: an open one can hang the interpreter's exit."""
        self._is_over.set()
        for session in self.all:
            # With 1,000 links on a busy machine this takes longer than Zenoh waits. Every message
            # is already out.
            with suppress(zenoh.ZError):
                session.close()


class RunSubscriber:
    """Receives every message of a run, and can answer.

    Messages wait in a queue of Zenoh's own, without any Python in between, until they are drained.
    When it is full, publishers wait or drop, see `SessionSettings.lockstep`.
    """

    def __init__(self, agent: str, wiring: Wiring, settings: SessionSettings) -> None:
        self._wiring = wiring
        self._outbox = Outbox()
        self._sessions = Sessions(wiring, settings)
        self.watch_tokens = self._sessions.watch_tokens
        self._subscribers = [
            session.declare_subscriber(
                f"{wiring.plant}/**",
                zenoh.handlers.FifoChannel(QUEUE_LENGTH),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for session in self._sessions.all
        ]
        self._sessions.show_token(agent)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        # A session does not close while Zenoh's thread waits for room in a queue.
        closing = threading.Thread(target=self._sessions.close)
        closing.start()
        while closing.is_alive():
            with suppress(zenoh.ZError):  # A session has closed.
                for _ in self.drain():
                    pass
            closing.join(0.01)

    def publish(self, port: Port[Message], message: Message) -> None:
        """Send a message, which must arrive: this waits for listeners that have fallen behind."""
        self._outbox.stamp(port, message, time.monotonic_ns())
        for session in self._sessions.all:
            session.put(
                self._wiring.key(port),
                encode(message),
                encoding=ENCODING,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )

    def drain(self) -> Iterator[tuple[str, bytes]]:
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                yield str(sample.key_expr), sample.payload.to_bytes()
