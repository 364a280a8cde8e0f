"""The bus between processes: one Zenoh session for each process, and one more beside devices.

Zenoh calls us on its own thread: the callback appends to a queue, and wakes the agent's thread or
acts itself (`agents.eager_driver`). See docs/decisions for what was measured.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from heapq import heappop, heappush
from itertools import count
from typing import Any, Final, NamedTuple, Self, TypeAlias

import zenoh

from bus_schemas.bus import Arrival, Cause, Outbox
from bus_schemas.codec import UNREADABLE, encode, encode_bundle
from bus_schemas.host_clock import HostClock
from bus_schemas.inbox import Inbox, Item, Source
from bus_schemas.messages import Message
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import DISPATCH, Occurrence, Port, Signal
from bus_schemas.tree import PLANT, RECORDER
from bus_schemas.wiring import Bundle, Wiring
from bus_schemas.zenoh_session import (
    ENCODING,
    SUBSCRIBER_BATCH_BYTES,
    Sessions,
    SessionSettings,
)

Put: TypeAlias = Callable[[bytes], None]
PutChange: TypeAlias = Callable[[Port[Message], Put], Put]
"""Returns what puts messages of a port instead."""

_MANY: Final = 30
"""From this many ports of a signal on, a process declares one wildcard: a session tells every peer
of each declaration, which among 1,000 inverters would be a million messages."""

_MOST_BUNDLED: Final = 80
_LARGEST_BUNDLE: Final = SUBSCRIBER_BATCH_BYTES - 512
"""Messages of a bundle, and bytes: a larger one would travel to the recorder in fragments, so it is
sent as two."""

_SHORTEST_S: Final = 0.01
"""Shortest time-out of a query."""


class _Route(NamedTuple):
    """Where the messages of a port go.

    name: The key without the plant's name.
    bundle: What its bundle holds so far; None: each message goes out by itself.
    hearers: Agents of the same process.
    """

    name: str
    bundle: list[tuple[str, Message]] | None
    hearers: tuple[str, ...]


class ZenohBus:
    """The bus of one process: a queue among its agents, Zenoh for what others hear.

    patience_s: Longest time that one call waits for messages.
    clock: Clock of the plant, if the plant is on another host.
    sends: Byte that says whether the process is sending: in lockstep it may have to wait for that.
    """

    def __init__(
        self,
        process: str,
        wiring: Wiring,
        settings: SessionSettings,
        patience_s: float,
        clock: HostClock | None = None,
        sends: memoryview | None = None,
    ) -> None:
        self.now_ns = time.monotonic_ns if clock is None else clock.now_ns
        self.inbox, self.outbox = Inbox(), Outbox()
        self._clock, self._sends = clock, sends
        self._wiring = wiring
        self._hearers: dict[Port[Message], list[str]] = {}
        for name in wiring.members[process]:
            for port in wiring.heard[name]:
                self._hearers.setdefault(port, []).append(name)
        self.heard = [
            port for port in self._hearers if wiring.process_of(port.publisher) != process
        ]
        # Messages among the agents of the process.
        self._own: deque[Arrival] = deque()
        self._patience_s = patience_s
        self._lockstep = settings.lockstep
        self._newest: dict[Port[Message], Message] = {}
        self._sessions = Sessions(wiring, settings)
        self.watch_tokens = self._sessions.watch_tokens
        # Messages that are to go out together: before the next single one, and before a wait.
        self._bundled: dict[Bundle, list[tuple[str, Message]]] = {
            bundle: [] for bundle in wiring.bundles if bundle.source == process
        }
        bundle_of = {port: bundle for bundle in self._bundled for port in bundle.ports.values()}
        self._puts = self._declare_publishers(process, settings, bundle_of)
        self._routes = {
            port: _Route(
                str(port),
                self._bundled[bundle_of[port]] if port in bundle_of else None,
                tuple(self._hearers.get(port, ())),
            )
            for port in wiring.carried[process, RECORDER]
        }
        self._declare_subscribers(process)
        if settings.lockstep:
            self._sessions.kept += (
                session.declare_queryable(
                    f"{wiring.plant}/**", zenoh.handlers.Callback(self._answer, indirect=False)
                )
                for session in self._sessions.all
            )
        self._sessions.show_token(process)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._sessions.close()

    def _declare_publishers(
        self, process: str, settings: SessionSettings, bundle_of: Mapping[Port[Message], Bundle]
    ) -> dict[Source, list[Put]]:
        """Return what puts the messages of each port, for agents and then for devices."""
        wiring = self._wiring
        devices = set(() if settings.devices is None else settings.devices.peers)
        published = wiring.carried[process, RECORDER]
        many = _signals_of_many(published)
        puts: dict[Source, list[Put]] = {}
        for source in dict.fromkeys(bundle_of.get(port, port) for port in published):
            # The session for devices carries only what they hear; the recorder hears all.
            hearers = wiring.listeners[source] if isinstance(source, Port) else source.sinks
            hears_there = not devices.isdisjoint({RECORDER, *hearers})
            must_arrive = settings.lockstep or source.signal.occurrence is Occurrence.EVENT
            control = zenoh.CongestionControl.BLOCK if must_arrive else zenoh.CongestionControl.DROP
            how: dict[str, Any] = {"encoding": ENCODING, "congestion_control": control}
            key = zenoh.KeyExpr(wiring.key(source))
            own, *to_devices = (
                partial(session.put, key, **how)
                if source.signal in many
                else session.declare_publisher(key, **how).put
                for session in self._sessions.all[: 2 if hears_there else 1]
            )
            puts[source] = [own, *to_devices]
        return puts

    def _declare_subscribers(self, process: str) -> None:
        bundles = [bundle for bundle in self._wiring.bundles if process in bundle.sinks]
        sources: list[Port[Message] | Bundle] = [*self.heard, *bundles]
        receive_of = {self._wiring.key(source): self.inbox.callback(source) for source in sources}

        def receive_many(sample: zenoh.Sample) -> None:
            if (receive := receive_of.get(str(sample.key_expr))) is not None:
                receive(sample)

        subscribed = {
            key: receive_of.get(key, receive_many)
            for key in (
                *self._wiring.key_exprs(self.heard, least=_MANY),
                *self._wiring.bundle_exprs(bundles, least=_MANY),
            )
        }
        self._sessions.kept += (
            session.declare_subscriber(
                key,
                zenoh.handlers.Callback(callback, indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for session in self._sessions.all
            for key, callback in subscribed.items()
        )

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        """Send a message. In lockstep this waits for listeners that have fallen behind."""
        self.outbox.stamp(port, message, now_ns)
        if self._lockstep:
            self._newest[port] = message
        name, bundle, hearers = self._routes[port]
        if bundle is None:
            if self._bundled:  # So the recorder knows no less than others.
                self.send_bundles()
            self._send(port, encode(message))
        else:
            bundle.append((name, message))
        for agent in hearers:
            self._own.append(Arrival(agent, port, message, now_ns))

    def send_bundles(self) -> None:
        for bundle, messages in self._bundled.items():
            for begin in range(0, len(messages), _MOST_BUNDLED):
                self._send_bundle(bundle, messages[begin : begin + _MOST_BUNDLED])
            messages.clear()

    def _send_bundle(self, bundle: Bundle, messages: Sequence[tuple[str, Message]]) -> None:
        payload, half = encode_bundle(messages), len(messages) // 2
        if half and len(payload) > _LARGEST_BUNDLE:
            self._send_bundle(bundle, messages[:half])
            self._send_bundle(bundle, messages[half:])
        else:
            self._send(bundle, payload)

    def _send(self, source: Source, payload: bytes) -> None:
        if self._sends is not None:
            self._sends[0] = True
        for put in self._puts[source]:
            put(payload)
        if self._sends is not None:
            self._sends[0] = False

    def change_device_puts(self, change: PutChange) -> None:
        for source, puts in self._puts.items():
            if isinstance(source, Port):
                puts[1:] = [change(source, put) for put in puts[1:]]

    def newest(self) -> list[Arrival]:
        """Return the newest message of each publisher heard in lockstep, the dispatch first.

        Publishers that do not answer within the patience are left out: the caller asks again.
        """
        taken, give_up_at = [], time.monotonic() + self._patience_s
        for session in self._sessions.all:
            for reply in session.get(
                f"{self._wiring.plant}/**",
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=max(give_up_at - time.monotonic(), _SHORTEST_S),
            ):
                if (sample := reply.ok) is not None:
                    port = self._wiring.port(str(sample.key_expr))
                    if port in self.heard:
                        taken.append((port, sample.payload.to_bytes(), time.monotonic_ns()))
        return self.arrivals(sorted(taken, key=lambda one: one[0].signal is not DISPATCH))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            for port, message in list(self._newest.items()):
                query.reply(self._wiring.key(port), encode(message), encoding=ENCODING)

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        """Return what has arrived: once `wanted` messages are there, or when the time has come."""
        if self._own:
            return self.arrivals([])
        self.send_bundles()
        give_up_at = time.monotonic() + self.timeout_s(until_ns)
        while taken := self.inbox.take(wanted, give_up_at - time.monotonic()):
            arrivals = self.arrivals(taken)
            if arrivals:  # Otherwise nothing has come that could be read.
                return arrivals
        return []

    def want(self, wanted: int) -> bool:
        """Ask for a call at this many messages; return whether they are there.

        A message among the agents of the process is always enough.
        """
        if self._own:
            return True
        self.send_bundles()
        return self.inbox.want(wanted)

    def timeout_s(self, until_ns: int | None) -> float:
        if until_ns is None:
            return self._patience_s
        return min(self._patience_s, (until_ns - self.now_ns()) / 1e9)

    def arrivals(self, taken: Sequence[Item]) -> list[Arrival]:
        """Return the messages among the agents of the process, then those from the inbox."""
        arrivals = list(self._own)
        self._own.clear()
        for source, payload, came_ns in taken:
            time_ns = came_ns
            try:
                messages = (
                    [(source, source.signal.decode(payload))]
                    if isinstance(source, Port)
                    else source.messages(payload)
                )
            except UNREADABLE:
                self.inbox.dropped[str(source), Cause.UNDECODABLE] += 1
                continue
            for port, message in messages:
                if self._clock is not None:
                    if port.publisher == PLANT:
                        self._clock.observe(message.publish_time_ns, came_ns)
                    time_ns = self._clock.at(came_ns)
                for name in self._hearers[port]:
                    arrivals.append(Arrival(name, port, message, time_ns))
        return arrivals


class FaultyBus:
    """A bus at the end of imperfect links: faults act where messages come in."""

    def __init__(self, bus: ZenohBus, faults: NetworkFaults) -> None:
        self._bus = bus
        self._faults = faults
        # The numbers order messages of one moment, which cannot be compared.
        self._numbers = count()
        self._under_way: list[tuple[int, int, Arrival]] = []

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        self._bus.publish(port, message, now_ns)

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`; a delayed message arrives when it is due."""
        if self._under_way:
            due_ns = self._under_way[0][0]
            until_ns = due_ns if until_ns is None else min(until_ns, due_ns)
        for arrival in self._bus.receive(until_ns, wanted):
            for delay_ns in self._faults.fates(arrival.port, arrival.agent, arrival.message):
                late = arrival._replace(time_ns=arrival.time_ns + delay_ns)
                heappush(self._under_way, (late.time_ns, next(self._numbers), late))
        now_ns, arrived = self._bus.now_ns(), []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived.append(heappop(self._under_way)[2])
        return arrived


def _signals_of_many(ports: Collection[Port[Message]]) -> list[Signal[Message]]:
    counts = Counter(port.signal for port in ports)
    return [signal for signal, count in counts.items() if count >= _MANY]
