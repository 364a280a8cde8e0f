"""The bus between processes: one Zenoh session for each agent, over TCP on the loopback address.

No multicast, no gossip: the endpoints are given. See docs/decisions for what was measured.
"""

from __future__ import annotations

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import msgspec
import zenoh

from bus_schemas.bus import Arrival, Outbox
from bus_schemas.codec import decode, encode
from bus_schemas.keys import KeyTable
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port, listeners, ports
from bus_schemas.tree import ControlTree

ENCODING: Final = "application/msgpack"
_NEVER: Final = 1 << 60
_TAP_CAPACITY: Final = 65536

_CROWDED: Final = 10_000
"""Samples that wait for an agent from which on each key has a limit: a flood must not take all."""

_MOST_OF_A_KEY: Final = 100
_MOST_WAITING: Final = 20_000
_MOST_KEYS: Final = 100
"""How many keys are named one by one of which samples could not be used."""


@dataclass(frozen=True)
class SessionSettings:
    """How an agent's session joins the others.

    Attributes
    ----------
    namespace
        Prefix of every key of the run.
    listen, connect
        Endpoints, for instance `tcp/127.0.0.1:7447`.
    mode
        `peer`, or `router` and `client` where a router is in between.
    gossip
        Whether peers tell each other of peers, and connect to those they hear of.
    lockstep
        In lockstep nothing may be lost: a publisher waits for a listener who falls behind. In real
        time a message that cannot go out within 20 ms is dropped instead.
    """

    namespace: str
    listen: list[str]
    connect: list[str]
    mode: str = "peer"
    gossip: bool = False
    lockstep: bool = True

    def config(self) -> zenoh.Config:
        """Return these settings as Zenoh wants them."""
        config = zenoh.Config()
        settings: Mapping[str, object] = {
            "mode": self.mode,
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
            "scouting/gossip/enabled": self.gossip,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 20000,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return config


class Inbox:
    """A queue between Zenoh's threads and the agent's: wakes the agent once enough has arrived.

    An agent that needs seventeen messages to go on is woken once, not seventeen times: each waking
    is a switch between threads that fight for the interpreter's lock.

    Attributes
    ----------
    flooded
        Samples that found no room, by key: more came than the agent could look at.
    """

    def __init__(self) -> None:
        self.flooded: Counter[str] = Counter()
        self._crowd: Counter[str] = Counter()
        self._items: deque[tuple[int, zenoh.Sample]] = deque()
        self._wanted = _NEVER
        self._urgent = False
        self._gate = threading.Lock()
        self._gate.acquire()

    def put(self, sample: zenoh.Sample) -> None:
        """Take in a sample. Called by Zenoh, so it does nothing else."""
        if len(self._items) >= _CROWDED and not self._has_room(sample):
            return
        self._items.append((time.monotonic_ns(), sample))
        if len(self._items) >= self._wanted:
            self._wanted = _NEVER
            self._open()

    def put_urgent(self, sample: zenoh.Sample) -> None:
        """Take in a sample that the agent must see at once, whatever else it waits for."""
        if len(self._items) >= _CROWDED and not self._has_room(sample):
            return
        self._items.append((time.monotonic_ns(), sample))
        self._urgent = True
        self._wanted = _NEVER
        self._open()

    def take(self, wanted: int, timeout_s: float | None) -> list[tuple[int, zenoh.Sample]]:
        """Return all samples and when each came [ns of the monotonic clock].

        It waits until `wanted` or an urgent one are there, or for the time-out.
        """
        if len(self._items) < wanted and not self._urgent:
            self._gate.acquire(blocking=False)  # an opening that came after the last waiting
            self._wanted = wanted
            if len(self._items) < wanted and not self._urgent:
                self._gate.acquire(timeout=-1 if timeout_s is None else max(timeout_s, 0.0))
            self._wanted = _NEVER
        self._urgent = False
        if self._crowd:
            self._crowd = Counter()
        return [self._items.popleft() for _ in range(len(self._items))]

    def _has_room(self, sample: zenoh.Sample) -> bool:
        """Whether a crowded inbox takes a sample: some of each key, so that none is kept out."""
        key = str(sample.key_expr)
        self._crowd[key] += 1
        if self._crowd[key] <= _MOST_OF_A_KEY and len(self._items) < _MOST_WAITING:
            return True
        self.flooded[named_key(key, self.flooded)] += 1
        return False

    def _open(self) -> None:
        with suppress(RuntimeError):  # Two samples at once: it is open already.
            self._gate.release()


class ZenohBus:
    """One agent's place on the bus.

    Parameters
    ----------
    agent
        Name of the agent.
    keys, tree
        The run's keys and control tree.
    settings
        Of the session.
    on_drop
        Called with a line of text for each message that cannot be used.
    """

    def __init__(
        self,
        agent: str,
        keys: KeyTable,
        tree: ControlTree,
        settings: SessionSettings,
        on_drop: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.outbox = Outbox()
        self.undecodable = 0
        self.unknown = 0
        self.publishing: Port[Message] | None = None
        self._keys = keys
        self._on_drop = on_drop
        self._inbox = Inbox()
        self._session = zenoh.open(settings.config())
        self._publishers = {
            port: self._declare_publisher(port, settings.lockstep)
            for port in ports(tree)
            if port.publisher == agent
        }
        self._put = {port: publisher.put for port, publisher in self._publishers.items()}
        heard = [port for port in ports(tree) if agent in listeners(port, tree)]
        self._subscribers = [
            self._subscribe(key, urgent)
            for key, urgent in _subscriptions(agent, heard, keys).items()
        ]
        self._token = self._session.liveliness().declare_token(keys.alive_key(agent))

    def __enter__(self) -> ZenohBus:
        return self

    def __exit__(self, *error: object) -> None:
        # An open session can hang the interpreter's exit.
        self._session.close()

    @property
    def flooded(self) -> Counter[str]:
        """Messages that found no room, since more came than the agent could look at.

        They are counted by key, without the plant's name.
        """
        plant = f"{self._keys.plant}/"
        return Counter({key.removeprefix(plant): n for key, n in self._inbox.flooded.items()})

    @property
    def published(self) -> Counter[str]:
        """Messages of the run published so far, by signal."""
        return self.outbox.published

    def publish(self, port: Port[Message], message: Message) -> None:
        """Send a message. In lockstep this waits for a listener who has fallen behind."""
        payload = encode(self.outbox.stamp(port, message))
        self.publishing = port
        self._put[port](payload)
        self.publishing = None

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`."""
        arrivals = []
        for time_ns, sample in self._inbox.take(wanted, timeout_s):
            arrival = self._unpack(str(sample.key_expr), sample.payload.to_bytes(), time_ns)
            if arrival is not None:
                arrivals.append(arrival)
        return arrivals

    def agents_alive(self, agents: Iterable[str]) -> set[str]:
        """Those of the agents whose liveliness token is seen."""
        pattern = f"{self._keys.plant}/**/alive"
        replies = self._session.liveliness().get(pattern, timeout=1.0)
        seen = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return {agent for agent in agents if self._keys.alive_key(agent) in seen}

    def _subscribe(self, key: str, urgent: bool) -> zenoh.Subscriber[None]:
        put = self._inbox.put_urgent if urgent else self._inbox.put
        return self._session.declare_subscriber(
            key,
            put,
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def _declare_publisher(self, port: Port[Message], lockstep: bool) -> zenoh.Publisher:
        must_arrive = lockstep or port.signal.occurrence is Occurrence.EVENT
        return self._session.declare_publisher(
            self._keys.key(port),
            encoding=ENCODING,
            congestion_control=(
                zenoh.CongestionControl.BLOCK if must_arrive else zenoh.CongestionControl.DROP
            ),
            reliability=zenoh.Reliability.RELIABLE,
        )

    def _unpack(self, key: str, payload: bytes, time_ns: int) -> Arrival | None:
        port = self._keys.port(key)
        if port is None:
            self.unknown += 1
            self._on_drop(f"{key} is of a node or signal that this run does not have")
            return None
        try:
            return Arrival(port, decode(port.signal, payload), time_ns)
        except msgspec.DecodeError as error:
            self.undecodable += 1
            self._on_drop(f"{key} does not decode: {error}")
            return None


class ZenohTap:
    """A listener's place on the bus: hears every message of the run, and can answer.

    Samples wait in a queue of Zenoh's own, without any Python in between, until they are drained
    in one go. When it is full, publishers that may not lose anything wait.
    """

    def __init__(self, agent: str, keys: KeyTable, settings: SessionSettings) -> None:
        self.outbox = Outbox()
        self._keys = keys
        self._session = zenoh.open(settings.config())
        self._subscriber = self._session.declare_subscriber(
            f"{keys.plant}/**",
            zenoh.handlers.FifoChannel(_TAP_CAPACITY),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._token = self._session.liveliness().declare_token(keys.alive_key(agent))
        self._tokens: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]] | None = None

    def __enter__(self) -> ZenohTap:
        return self

    def __exit__(self, *error: object) -> None:
        self._session.close()

    def publish(self, port: Port[Message], message: Message) -> None:
        """Send a message."""
        payload = encode(self.outbox.stamp(port, message))
        self._session.put(self._keys.key(port), payload, encoding=ENCODING)

    def watch_presence(self) -> None:
        """Follow the liveliness tokens of all agents from now on, see `presence`."""
        self._tokens = self._session.liveliness().declare_subscriber(
            self._keys.alive_key("**"), zenoh.handlers.FifoChannel(_TAP_CAPACITY), history=True
        )

    def presence(self) -> Iterator[tuple[str, bool]]:
        """Yield the key of each liveliness token that has come (True) or gone (False)."""
        while self._tokens is not None and (sample := self._tokens.try_recv()) is not None:
            yield str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT

    def drain(self) -> Iterator[tuple[str, bytes]]:
        """Yield key and payload of all that has arrived."""
        while (sample := self._subscriber.try_recv()) is not None:
            yield str(sample.key_expr), sample.payload.to_bytes()


def named_key(key: str, named: Counter[str]) -> str:
    """Return the name under which to count a key: its own, as long as there are not too many."""
    return key if key in named or len(named) < _MOST_KEYS else "other keys"


def _subscriptions(agent: str, heard: list[Port[Message]], keys: KeyTable) -> dict[str, bool]:
    """Key expressions for the ports that an agent hears, and whether they are urgent.

    It names its own node in full, and takes siblings together: `oahu/c1/*/impp`. So it also hears
    a node that this run does not know, and can say so.
    """
    expressions: dict[str, bool] = {}
    for port in heard:
        key = keys.key(port)
        if port.node and port.node != agent:
            head, _, signal = key.rpartition("/")
            key = f"{head.rpartition('/')[0]}/*/{signal}"
        expressions[key] = port.signal.occurrence is Occurrence.EVENT
    return expressions
