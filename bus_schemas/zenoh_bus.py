"""The bus between processes: one Zenoh session for each agent, over TCP on the loopback address.

Zenoh calls us on its own thread: the callback appends to a queue, and wakes the agent's thread or
acts itself (`agents.eager_driver`). See docs/decisions for what was measured.
"""

from __future__ import annotations

import ctypes
import json
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

import msgspec
import zenoh

from bus_schemas.bus import Arrival, Outbox
from bus_schemas.codec import decode, encode
from bus_schemas.host_clock import HostClock
from bus_schemas.messages import LARGEST_PAYLOAD, Message
from bus_schemas.signals import DISPATCH, Occurrence, Port, Signal
from bus_schemas.tree import PLANT, RECORDER, agent_of
from bus_schemas.wiring import Wiring

ENCODING: Final = "application/msgpack"

ZENOH_RUNTIME: Final = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), "
    "app: (worker_threads: 1))"
)
"""One worker thread for all of Zenoh's work: see docs/decisions/0003-zenoh-tuning.md."""

MOST_LINKS: Final = 10_000

LEASE_MS: Final = 60_000
"""How long a link may be silent [ms]. A process that ends closes its links at once; one that stands
still for less comes back to them. Among 1,000 inverters a short lease costs a processor."""

_NEVER: Final = 1 << 60
_TAP_CAPACITY: Final = 24_576
TAP_BATCH_BYTES: Final = 16_384
"""A message that waits keeps the buffer in memory that its batch came in, here some 21 kB: a full
queue takes 512 MB. With Zenoh's own 64 kB it was 48 kB. The 16 batches of a link's queue still hold
what a plant of 1,000 inverters sends at once."""

_ANSWER_S: Final = 5.0
_CROWDED: Final = 10_000
"""Messages that wait for an agent from which on each port has a limit: a flood of one port must
neither take all memory nor keep the others out."""

_MOST_OF_A_PORT: Final = 100

_MANY: Final = 30
"""Ports of one signal from which on an agent declares them together: a session tells every peer of
each declaration, which among 1,000 inverters would be a million messages."""


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
            "transport/unicast/max_sessions": MOST_LINKS,
            "transport/unicast/accept_pending": MOST_LINKS,
            # By default 10 s. Plant and recorder open 1,000 links one after the other; one that
            # was given up half open would look whole to the other end, and carry nothing.
            "transport/unicast/accept_timeout": LEASE_MS,
            "transport/unicast/open_timeout": LEASE_MS,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 20000,
            # A plant of 1,000 inverters puts 200 kB at once on its link to the recorder.
            "transport/link/tx/queue/size/data": 16,
            "transport/link/tx/lease": LEASE_MS,
            "transport/link/rx/max_message_size": LARGEST_PAYLOAD,
            "transport/link/protocols": ["tcp"],
        }
        if self.lockstep:
            # By default a listener who stands still for 5 s is cut off, and lacks what is sent.
            settings["transport/link/tx/queue/congestion_control/block/wait_before_close"] = (
                LEASE_MS * 1000
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


_this_thread = threading.local()


class Inbox:
    """A queue from Zenoh's thread to the agent's: wakes the agent once, when enough has arrived.

    dropped: Messages that found no room, by port and cause.
    on_enough: Called on Zenoh's thread. By default it wakes the agent's.
    """

    def __init__(self) -> None:
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.on_enough: Callable[[], None] = self.wake
        self._waiting: Counter[Port[Message]] = Counter()
        self._items: deque[tuple[Port[Message], zenoh.ZBytes, int]] = deque()
        self._wanted = _NEVER
        self._urgent = False
        self._gate = threading.Lock()
        self._gate.acquire()

    def callback(self, port: Port[Message]) -> Callable[[zenoh.Sample], None]:
        items, append, now_ns = self._items, self._items.append, time.monotonic_ns
        urgent = port.signal.occurrence is Occurrence.EVENT

        def hear(sample: zenoh.Sample) -> None:
            if not hasattr(_this_thread, "is_kept"):
                # Otherwise Python makes and discards a state of Zenoh's thread for each callback:
                # an eighth of the processor time of a cycle.
                ctypes.pythonapi.PyGILState_Ensure()
                _this_thread.is_kept = True
            if len(items) >= _CROWDED and not self._has_room(port):
                return
            append((port, sample.payload, now_ns()))
            if len(items) >= self._wanted or urgent:
                self._wanted = _NEVER
                self._urgent = self._urgent or urgent
                self.on_enough()

        return hear

    def want(self, wanted: int) -> bool:
        """Ask to be called once so many or an urgent one are there; return whether they are."""
        self._wanted = wanted
        # The last one may have come just before that.
        return len(self._items) >= wanted or (self._urgent and bool(self._items))

    def sleep(self, timeout_s: float) -> None:
        """Sleep until somebody wakes the agent, or the time-out has come."""
        if timeout_s > 0.0:
            self._gate.acquire(timeout=timeout_s)

    def wake(self) -> None:
        with suppress(RuntimeError):  # Two messages at once: it is awake already.
            self._gate.release()

    def take(
        self, wanted: int = 0, timeout_s: float = 0.0
    ) -> list[tuple[Port[Message], zenoh.ZBytes, int]]:
        until = time.monotonic() + timeout_s
        # An opening may be left over from messages that were taken already.
        while timeout_s > 0.0 and not self.want(wanted):
            self.sleep(timeout_s)
            timeout_s = until - time.monotonic()
        self._wanted = _NEVER
        self._urgent = False
        if self._waiting:
            self._waiting = Counter()
        items = self._items
        return [items.popleft() for _ in range(len(items))]

    def _has_room(self, port: Port[Message]) -> bool:
        self._waiting[port] += 1
        if self._waiting[port] <= _MOST_OF_A_PORT:
            return True
        self.dropped[str(port), "flooded"] += 1
        return False


class TokenWatch:
    """The liveliness tokens of all agents, as an agent's sessions see them."""

    def __init__(self, sessions: Sequence[zenoh.Session], wiring: Wiring) -> None:
        self._alive: set[str] = set()
        self._subscribers = [
            session.liveliness().declare_subscriber(
                wiring.alive_key("**"), zenoh.handlers.FifoChannel(_TAP_CAPACITY), history=True
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


class _Place:
    """An agent's sessions, open until the context is left."""

    def __init__(self, wiring: Wiring, settings: SessionSettings) -> None:
        self.outbox = Outbox()
        self._wiring = wiring
        self._sessions = open_sessions(settings)

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
        key = self._wiring.alive_key(process)
        self._tokens = [session.liveliness().declare_token(key) for session in self._sessions]


class ZenohBus(_Place):
    """One agent's place on the bus, in its process or that of its standby.

    patience_s: Longest time that one call waits for messages.
    clock: Clock of the plant, if the plant is on another host.

    dropped: Messages that could not be read or found no room, by port and cause.
    """

    def __init__(
        self,
        process: str,
        wiring: Wiring,
        settings: SessionSettings,
        patience_s: float,
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(wiring, settings)
        self.now_ns = time.monotonic_ns if clock is None else clock.now_ns
        self._clock = clock
        self.inbox = Inbox()
        self.dropped = self.inbox.dropped
        self._process = process
        self._patience_s = patience_s
        devices = set(() if settings.devices is None else settings.devices.peers)
        agent = agent_of(process)
        published, heard = wiring.published[agent], wiring.heard.get(agent, [])
        self._heard = frozenset(heard)
        many = _signals_of_many(published)
        self._puts: dict[Port[Message], list[Callable[[bytes], None]]] = {}
        for port in published:
            # The session for devices needs only what is heard there; the recorder hears all.
            hears_there = not devices.isdisjoint({RECORDER, *wiring.processes[port]})
            must_arrive = settings.lockstep or port.signal.occurrence is Occurrence.EVENT
            control = zenoh.CongestionControl.BLOCK if must_arrive else zenoh.CongestionControl.DROP
            how: dict[str, Any] = {"encoding": ENCODING, "congestion_control": control}
            key = zenoh.KeyExpr(wiring.key(port))
            self._puts[port] = [
                partial(session.put, key, **how)
                if port.signal in many
                else session.declare_publisher(key, **how).put
                for session in self._sessions[: 2 if hears_there else 1]
            ]
        many = _signals_of_many(heard)
        hear_of = {wiring.key(port): self.inbox.callback(port) for port in heard}

        def hear_many(sample: zenoh.Sample) -> None:
            if (hear := hear_of.get(str(sample.key_expr))) is not None:
                hear(sample)

        alone = [wiring.key(port) for port in heard if port.signal not in many]
        subscribed = {key: hear_of[key] for key in alone}
        subscribed |= {f"{wiring.plant}/**/{signal.name}": hear_many for signal in many}
        self._subscribers = [
            session.declare_subscriber(
                key,
                zenoh.handlers.Callback(callback, indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for session in self._sessions
            for key, callback in subscribed.items()
        ]
        self._newest: dict[Port[Message], bytes] = {}
        if settings.lockstep:
            self._queryables = [
                session.declare_queryable(
                    f"{wiring.plant}/**", zenoh.handlers.Callback(self._answer, indirect=False)
                )
                for session in self._sessions
            ]
        self._show_token(process)

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        """Send a message. In lockstep this waits for a listener who has fallen behind."""
        self.outbox.stamp(port, message, now_ns)
        payload = encode(message)
        self._newest[port] = payload
        for put in self._puts[port]:
            put(payload)

    def newest(self) -> list[Arrival]:
        """Return the newest messages of those that are heard in lockstep, the dispatch first."""
        taken = []
        for session in self._sessions:
            for reply in session.get(
                f"{self._wiring.plant}/**",
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=_ANSWER_S,
            ):
                if (sample := reply.ok) is not None:
                    port = self._wiring.port(str(sample.key_expr))
                    if port in self._heard:
                        taken.append((port, sample.payload, time.monotonic_ns()))
        return self._decoded(sorted(taken, key=lambda one: one[0].signal is not DISPATCH))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            for port, payload in list(self._newest.items()):
                query.reply(self._wiring.key(port), payload, encoding=ENCODING)

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        """Return what has arrived: once `wanted` messages are there, or when the time has come."""
        give_up_at = time.monotonic() + self.timeout_s(until_ns)
        while taken := self.inbox.take(wanted, give_up_at - time.monotonic()):
            arrivals = self._decoded(taken)
            if arrivals:  # Otherwise nothing has come that could be read.
                return arrivals
        return []

    def take(self) -> list[Arrival]:
        return self._decoded(self.inbox.take())

    def timeout_s(self, until_ns: int | None) -> float:
        """How long to wait for a time of the run's clock, at most for the patience."""
        if until_ns is None:
            return self._patience_s
        return min(self._patience_s, (until_ns - self.now_ns()) / 1e9)

    def _decoded(self, taken: list[tuple[Port[Message], zenoh.ZBytes, int]]) -> list[Arrival]:
        arrivals = []
        for port, payload, time_ns in taken:
            try:
                message = decode(port.signal, payload.to_bytes())
            except msgspec.DecodeError:
                self.dropped[str(port), "undecodable"] += 1
            else:
                came_ns = time_ns
                if self._clock is not None:
                    if port.publisher == PLANT:
                        self._clock.hear(message.publish_time_ns, time_ns)
                    came_ns = self._clock.at(time_ns)
                arrivals.append(Arrival(self._process, port, message, came_ns))
        return arrivals


def _signals_of_many(ports: Sequence[Port[Message]]) -> list[Signal[Message]]:
    counts = Counter(port.signal for port in ports)
    return [signal for signal, count in counts.items() if count >= _MANY]


class ZenohTap(_Place):
    """A listener's place on the bus: hears every message of the run, and can answer.

    Messages wait in a queue of Zenoh's own, without any Python in between, until they are drained.
    When it is full, publishers wait or drop, see `SessionSettings.lockstep`.
    """

    def __init__(self, agent: str, wiring: Wiring, settings: SessionSettings) -> None:
        super().__init__(wiring, settings)
        self._subscribers = [
            session.declare_subscriber(
                f"{wiring.plant}/**",
                zenoh.handlers.FifoChannel(_TAP_CAPACITY),
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
