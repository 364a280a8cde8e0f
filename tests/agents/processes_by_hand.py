"""A process in real time as `Runtime` has it, on a bus that is not there and a clock by hand."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple, TypeVar, cast

from clock_by_hand import ClockByHand

from agents.agent import Agent
from agents.drop_log import DropLog
from agents.events import Event
from agents.lifeline import Lifeline
from agents.plan import RunPlan
from agents.runtime import Runtime
from bus_schemas.bus import Arrival
from bus_schemas.messages import Message, Timing
from bus_schemas.signals import Port, Signal
from bus_schemas.zenoh_bus import ZenohBus

S = TypeVar("S")


class Sent(NamedTuple):
    """A message that a process published, and when."""

    port: Port[Message]
    message: Message
    time_ns: int


class FedBus:
    """Brings what it is given; where that is nothing it lets as much time pass as it may wait."""

    def __init__(self, clock: ClockByHand) -> None:
        self.sent: list[Sent] = []
        self.to_come: list[Arrival] = []
        self.undecodable = self.unknown = 0
        self.flooded: Counter[str] = Counter()
        self.publishing = None
        self.published: Counter[str] = Counter()
        self.keeps = True
        self._clock = clock

    def publish(self, port: Port[Message], message: Message) -> None:
        if self.keeps:
            self.sent.append(Sent(port, message, self._clock.now_ns))

    def receive(self, wanted: int, timeout_s: float | None) -> list[Arrival]:
        if not self.to_come:
            assert timeout_s is not None, "it would wait for ever"
            self._clock.sleep(timeout_s)
        arrivals, self.to_come = self.to_come, []
        return arrivals

    def timings(self) -> list[Timing]:
        """What the process said of itself."""
        return [message for _, message, _ in self.sent if isinstance(message, Timing)]

    def cycles(self, signal: Signal[Message]) -> list[int]:
        """Cycles of the messages of a signal, in their order."""
        return [message.cycle for port, message, _ in self.sent if port.signal is signal]


class KeptLine(Lifeline):
    """Keeps what is told."""

    def __init__(self) -> None:
        super().__init__(attached=False)
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)


class ProcessByHand:
    """An agent of a plan as a process that stands at the time of its clock.

    Parameters
    ----------
    agent, plan
        Of the process.

    Attributes
    ----------
    clock, bus, line
        What it has of the world.
    runtime
        The process itself.
    start_ns
        When the clock began.
    """

    def __init__(self, agent: Agent[S], plan: RunPlan) -> None:
        self.clock = ClockByHand()
        self.bus = FedBus(self.clock)
        self.line = KeptLine()
        self.start_ns = self.clock.now_ns
        self._cycle_ns = plan.cycle_wall_ns
        self.runtime = Runtime(
            agent, plan, cast(ZenohBus, self.bus), self.line, DropLog(), now_ns=self.clock
        )

    def begin(self, cycles_ago: float = 0.0) -> None:
        """Let cycle 0 have begun so many cycles ago, and this process have stood still since."""
        self.runtime.begin(self.clock.now_ns - round(cycles_ago * self._cycle_ns))

    def run_for(self, wall_s: float) -> None:
        """Let it run for a time."""
        end_ns = self.clock.now_ns + round(wall_s * 1e9)
        while self.clock.now_ns < end_ns:
            self.runtime.turn((end_ns - self.clock.now_ns) / 1e9)

    def into_cycles(self) -> list[float]:
        """When it said what it said of itself, in cycles of the clock since its beginning."""
        return [
            (sent.time_ns - self.start_ns) / self._cycle_ns
            for sent in self.bus.sent
            if isinstance(sent.message, Timing)
        ]
