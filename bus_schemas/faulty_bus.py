"""An imperfect network between processes: what arrives is lost, late or double, by the rules.

The faults act where messages come in. So a message goes over the real network first, and what the
rules take from it or add to its time comes on top.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count
from typing import Final

from bus_schemas.bus import Arrival
from bus_schemas.faults import FaultTally, NetworkFaults
from bus_schemas.keys import KeyTable
from bus_schemas.signals import Occurrence
from bus_schemas.tree import ControlTree
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus

_NEVER_NS: Final = 1 << 62


class FaultyBus(ZenohBus):
    """One agent's place on the bus, at the end of imperfect links.

    Parameters
    ----------
    agent, keys, tree, settings, on_drop
        See `ZenohBus`.
    faults
        Of the run.

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
    ) -> None:
        self.tally = FaultTally()
        self._agent = agent
        self._faults = faults
        # The numbers keep the order of what is due at one moment, and messages uncompared.
        self._numbers = count()
        self._under_way: list[tuple[int, int, Arrival]] = []
        super().__init__(agent, keys, tree, settings, on_drop)

    def __enter__(self) -> FaultyBus:
        super().__enter__()
        return self

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        """Return what has arrived, see `Bus.receive`; a delayed message arrives when it is due."""
        now_ns = time.monotonic_ns()
        gives_up_ns = _NEVER_NS if timeout_s is None else now_ns + round(timeout_s * 1e9)
        ready: list[Arrival] = []
        while True:
            wakes_ns = min(gives_up_ns, self._next_due_ns())
            waits = wakes_ns > now_ns
            wait_s = None if wakes_ns == _NEVER_NS else (wakes_ns - now_ns) / 1e9
            heard = super().receive(wanted - len(ready) if waits else 0, wait_s)
            is_urgent = self._put_under_way(heard)
            now_ns = time.monotonic_ns()
            while self._next_due_ns() <= now_ns:
                ready.append(heappop(self._under_way)[2])
            if len(ready) >= wanted or is_urgent or now_ns >= gives_up_ns:
                return ready

    def _put_under_way(self, arrivals: list[Arrival]) -> bool:
        """Let what has come in go on to the end of its link; return whether it is urgent."""
        for port, message, time_ns in arrivals:
            fate = self._faults.fates(port, self._agent, message)
            self.tally.count(fate)
            for delay_ns in fate:
                due_ns = time_ns + delay_ns
                arrival = Arrival(port, message, due_ns)
                heappush(self._under_way, (due_ns, next(self._numbers), arrival))
        return any(port.signal.occurrence is Occurrence.EVENT for port, _, _ in arrivals)

    def _next_due_ns(self) -> int:
        return self._under_way[0][0] if self._under_way else _NEVER_NS
