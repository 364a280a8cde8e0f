"""The bus inside one process, with or without a virtual clock.

With a clock nothing waits: it jumps to the next arrival, or to the time until which a receiver
waits. So a run is the same each time, to the last bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from heapq import heappop, heappush
from itertools import count

from bus_schemas.bus import Arrival, Outbox
from bus_schemas.messages import Message
from bus_schemas.network_faults import UNHARMED, NetworkFaults
from bus_schemas.signals import Port


class VirtualClock:
    """A clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


class MemoryBus:
    """One bus for all agents of a process, with one queue.

    on_publish: Called with every message, as a recorder would hear it.
    clock: Set to the time of each arrival. None: lockstep, where nothing waits for a time.
    faults: Of the network; they need a clock.
    """

    def __init__(
        self,
        listeners: Mapping[Port[Message], Sequence[str]],
        on_publish: Callable[[Port[Message], Message], None] | None = None,
        clock: VirtualClock | None = None,
        faults: NetworkFaults | None = None,
    ) -> None:
        self.outbox = Outbox()
        self._listeners = listeners
        self._on_publish = on_publish
        self._clock = clock
        self.faults = faults
        self._arrived: deque[Arrival] = deque()
        # The numbers order messages of one moment, which cannot be compared.
        self._numbers = count()
        self._under_way: list[tuple[int, int, Arrival]] = []
        self._held: dict[str, list[Arrival] | None] = {}

    def hold(self, agent: str, *, keep: bool) -> None:
        """Deliver nothing to an agent from now on; keep or lose its messages."""
        self._held[agent] = [] if keep else None

    def release(self, agent: str) -> None:
        """Deliver to an agent again, the kept messages first."""
        self._arrived.extendleft(reversed(self._held.pop(agent) or []))

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        self.outbox.stamp(port, message, now_ns)
        if self._on_publish is not None:
            self._on_publish(port, message)
        faults, arrived = self.faults, self._arrived
        for agent in self._listeners.get(port, ()):
            fate = UNHARMED if faults is None else faults.fates(port, agent, message)
            if fate is UNHARMED:
                arrived.append(Arrival(agent, port, message, now_ns))
            else:
                self._send(Arrival(agent, port, message, now_ns), fate)

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        """Return the next messages, all of one moment; nothing if none comes before a time."""
        # A message that arrives at a deadline is in time.
        while self._arrived or (
            self._under_way and (until_ns is None or self._under_way[0][0] <= until_ns)
        ):
            if self._arrived:
                arrivals = list(self._arrived)
                self._arrived.clear()
            else:
                arrivals = [heappop(self._under_way)[2]]
                self._set_clock(arrivals[0].time_ns)
            if self._held:
                arrivals = [arrival for arrival in arrivals if not self._is_held(arrival)]
            if arrivals:
                return arrivals
        if until_ns is not None:
            self._set_clock(until_ns)
        return ()

    def _is_held(self, arrival: Arrival) -> bool:
        if arrival.agent not in self._held:
            return False
        kept = self._held[arrival.agent]
        if kept is not None:
            kept.append(arrival)
        return True

    def _send(self, arrival: Arrival, fate: tuple[int, ...]) -> None:
        for delay_ns in fate:
            if delay_ns:
                late = arrival._replace(time_ns=arrival.time_ns + delay_ns)
                heappush(self._under_way, (late.time_ns, next(self._numbers), late))
            else:
                self._arrived.append(arrival)

    def _set_clock(self, time_ns: int) -> None:
        if self._clock is not None:
            self._clock.now_ns = max(self._clock.now_ns, time_ns)
