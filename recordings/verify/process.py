"""One process of an agent, whose recorded stages are run again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from agents.driver import Driver
from agents.loop import AgentLoop
from bus_schemas.bus import Arrival, Delivery
from bus_schemas.memory_bus import VirtualClock
from bus_schemas.messages import Message
from bus_schemas.signals import Port

Messages: TypeAlias = dict[Port[Message], Message]


class RecordedInputs:
    """A bus for one process: it delivers the recorded inputs of a stage, and nothing else.

    sent: What the agent published, by cycle and stage.
    """

    def __init__(self, stage_of: Mapping[Port[Message], str]) -> None:
        self.coming: list[Arrival] = []
        self.sent: dict[tuple[int, str], list[Delivery]] = {}
        self._stage_of = stage_of

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        place = message.cycle, self._stage_of[port]
        self.sent.setdefault(place, []).append((port, message))

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        arrivals, self.coming = self.coming, []
        return arrivals


@dataclass
class Process:
    """A process of an agent, that is, one incarnation.

    stage_of: The stage in which it publishes on each port.
    remembers: Whether the agent remembers earlier cycles.
    began_in: Cycle in which it took over as standby, maybe after the first stage; -1: no standby.
    is_over: Whether its state is uncertain, so that nothing more is compared.
    heard: Newest cycle of each input.
    sequence: Number of the next message of each port.
    spoke: Cycle of the last recorded message of each port.
    """

    loop: AgentLoop[Any]
    stage_of: Mapping[Port[Message], str]
    remembers: bool
    began_in: int
    is_over: bool
    heard: dict[Port[Message], int]
    sequence: dict[Port[Message], int] = field(default_factory=dict)
    spoke: dict[Port[Message], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._clock = VirtualClock()
        self._bus = RecordedInputs(self.stage_of)
        self._driver = Driver([self.loop], self._bus, self._clock)

    def go_to(self, begin_ns: int) -> None:
        """Go to the cycle that begins at a time, unless it is under way."""
        self._clock.now_ns = max(self._clock.now_ns, begin_ns)
        self._driver.join(self.loop)

    def close(self, cycle: int, stage: str, inputs: Messages) -> None:
        """Close a stage of a cycle on its inputs, and the following ones that await nothing."""
        loop, place = self.loop, (cycle, stage)
        if (loop.cycle, loop.stage) == place:
            # What the stage awaits comes last, since that closes it.
            ports = sorted(inputs, key=loop.waiting.__contains__)
            self._bus.coming = [Arrival(loop.name, port, inputs[port], 0) for port in ports]
            self._driver.turn()
        if (loop.cycle, loop.stage) == place:  # Nothing else will come: its deadline is now.
            self._clock.now_ns += 1
            loop.deadline_ns = self._clock.now_ns
            self._driver.go_on(loop)
            self._driver.turn()

    def sent(self, cycle: int, stage: str) -> list[Delivery]:
        """Return what the agent has published in a stage of a cycle, and forget it."""
        return self._bus.sent.pop((cycle, stage), [])
