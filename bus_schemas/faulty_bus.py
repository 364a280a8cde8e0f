"""An imperfect network between processes: the faults act where messages come in."""

from __future__ import annotations

from heapq import heappop, heappush
from itertools import count

from bus_schemas.bus import Arrival
from bus_schemas.messages import Message
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import Port
from bus_schemas.zenoh_bus import ZenohBus


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
        self._bus.publish(port, message, now_ns)

    def receive(self, until_ns: int | None, wanted: int = 1) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`; a delayed message arrives when it is due."""
        if self._under_way:
            due_ns = self._under_way[0][0]
            until_ns = due_ns if until_ns is None else min(until_ns, due_ns)
        for arrival in self._bus.receive(until_ns, wanted):
            for delay_ns in self._faults.fates(arrival.port, self._agent, arrival.message):
                late = arrival._replace(time_ns=arrival.time_ns + delay_ns)
                heappush(self._under_way, (late.time_ns, next(self._numbers), late))
        now_ns, arrived = self._bus.now_ns(), []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived.append(heappop(self._under_way)[2])
        return arrived
