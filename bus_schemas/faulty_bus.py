"""An imperfect network between processes: what arrives is lost, late or double, by the rules.

The faults act where messages come in. So a message goes over the real network first, and what the
rules take from it or add to its time comes on top.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count
from typing import Final

from bus_schemas.bus import Arrival
from bus_schemas.faults import FaultTally, NetworkFaults
from bus_schemas.keys import KeyTable
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tree import ControlTree
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus

_NEVER_NS: Final = 1 << 62

_CROWDED: Final = 10_000
_MOST_OF_A_PORT: Final = 1_000
"""From so many messages under way on, each port has at most so many, or as many as the rules of the
network can hold of what its publisher says once a cycle."""


class UnderWay:
    """Messages on the way to the end of their links. A flood of them must not take all the memory.

    Where it is crowded each port has its own limit, so that none is kept out by another; as there
    are no more ports than an agent hears, that bounds them all.

    Parameters
    ----------
    most_of_a_port
        That limit.

    Attributes
    ----------
    flooded
        Messages that found no room, by port.
    """

    def __init__(self, most_of_a_port: int = _MOST_OF_A_PORT) -> None:
        self.flooded: Counter[str] = Counter()
        self._most_of_a_port = most_of_a_port
        # The numbers keep the order of what is due at one moment, and messages uncompared.
        self._numbers = count()
        self._heap: list[tuple[int, int, Arrival]] = []
        self._of_port: Counter[Port[Message]] = Counter()

    def __len__(self) -> int:
        return len(self._heap)

    def put(self, arrival: Arrival) -> None:
        """Take in a message that arrives at its time, if there is room for it."""
        port = arrival.port
        if len(self._heap) >= _CROWDED and self._of_port[port] >= self._most_of_a_port:
            self.flooded[str(port)] += 1
            return
        self._of_port[port] += 1
        heappush(self._heap, (arrival.time_ns, next(self._numbers), arrival))

    @property
    def next_due_ns(self) -> int:
        """When the next one arrives; beyond all times if none is under way."""
        return self._heap[0][0] if self._heap else _NEVER_NS

    def take_due(self, now_ns: int) -> list[Arrival]:
        """Return those that have arrived by now, in the order of their times."""
        due = []
        while self.next_due_ns <= now_ns:
            arrival = heappop(self._heap)[2]
            self._of_port[arrival.port] -= 1
            due.append(arrival)
        return due


class FaultyBus(ZenohBus):
    """One agent's place on the bus, at the end of imperfect links.

    Parameters
    ----------
    agent, keys, tree, settings, on_drop
        See `ZenohBus`.
    faults
        Of the run.
    now_ns
        The clock: monotonic nanoseconds.

    Attributes
    ----------
    tally
        What the faults did to messages.
    """

    def __init__(
        self,
        agent: str,
        keys: KeyTable,
        tree: ControlTree,
        settings: SessionSettings,
        faults: NetworkFaults,
        on_drop: Callable[[str], None] = lambda text: None,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.tally = FaultTally()
        self._agent = agent
        self._faults = faults
        self._under_way = UnderWay(max(_MOST_OF_A_PORT, faults.most_under_way(agent)))
        self._now_ns = now_ns
        super().__init__(agent, keys, tree, settings, on_drop)

    def __enter__(self) -> FaultyBus:
        super().__enter__()
        return self

    @property
    def flooded(self) -> Counter[str]:
        """Messages that found no room, on the way or before the agent, by key."""
        return super().flooded + self._under_way.flooded

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`; a delayed message arrives when it is due."""
        now_ns = self._now_ns()
        gives_up_ns = _NEVER_NS if timeout_s is None else now_ns + round(timeout_s * 1e9)
        ready: list[Arrival] = []
        while True:
            wakes_ns = min(gives_up_ns, self._under_way.next_due_ns)
            waits = wakes_ns > now_ns
            wait_s = None if wakes_ns == _NEVER_NS else (wakes_ns - now_ns) / 1e9
            heard = super().receive(wanted - len(ready) if waits else 0, wait_s)
            is_urgent = self._put_under_way(heard)
            now_ns = self._now_ns()
            ready += self._under_way.take_due(now_ns)
            if len(ready) >= wanted or is_urgent or now_ns >= gives_up_ns:
                return ready

    def _put_under_way(self, arrivals: list[Arrival]) -> bool:
        """Let what has come in go on to the end of its link; return whether it is urgent."""
        for port, message, time_ns in arrivals:
            fate = self._faults.fates(port, self._agent, message)
            self.tally.count(fate)
            for delay_ns in fate:
                self._under_way.put(Arrival(port, message, time_ns + delay_ns))
        return any(port.signal.occurrence is Occurrence.EVENT for port, _, _ in arrivals)
