"""An imperfect network between processes: loses, delays and duplicates what arrives.

The faults act where messages come in. So a message goes over the real network first, and what the
rules take from it or add to its time comes on top.
"""

from __future__ import annotations

from heapq import heappop, heappush
from itertools import count
from typing import Final

from bus_schemas.bus import Arrival
from bus_schemas.messages import Message
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import Port
from bus_schemas.zenoh_bus import ZenohBus

_MOST_UNDER_WAY: Final = 100_000
"""Messages on their way at most: a flood of them must not take all memory."""


class FaultyBus:
    """One agent's place on the bus, at the end of imperfect links."""

    def __init__(self, bus: ZenohBus, agent: str, faults: NetworkFaults) -> None:
        self._bus = bus
        self._agent = agent
        self._faults = faults
        # The numbers keep the order of what is due at one moment, and messages uncompared.
        self._numbers = count()
        self._under_way: list[tuple[int, int, Arrival]] = []

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        """Send a message: faults act where it comes in."""
        self._bus.publish(port, message, now_ns)

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`; a delayed message arrives when it is due."""
        if self._under_way:
            due_ns = self._under_way[0][0]
            until_ns = due_ns if until_ns is None else min(until_ns, due_ns)
        for arrival in self._bus.receive(until_ns, wanted):
            for delay_ns in self._faults.fates(arrival.port, self._agent, arrival.message):
                if delay_ns and len(self._under_way) >= _MOST_UNDER_WAY:
                    self._bus.dropped[str(arrival.port), "flooded"] += 1
                    continue
                late = arrival._replace(time_ns=arrival.time_ns + delay_ns)
                heappush(self._under_way, (late.time_ns, next(self._numbers), late))
        now_ns, arrived = self._bus.now_ns(), []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived.append(heappop(self._under_way)[2])
        return arrived
