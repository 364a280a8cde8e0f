"""Takes one agent through its cycles: collects the inputs of a stage, closes it, goes on.

A stage closes when all that it awaits has arrived, or when whoever drives it says that its
deadline has passed. The sequencer has neither clock nor bus: it is the same in a process, in
memory and against a recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from agents.agent import Agent, Stage, Turn
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port

S = TypeVar("S")

BEFORE_ARMING: Final = -(2**31)
"""The cycle that an agent is in before its first message: any message takes it further."""


@dataclass
class Drops:
    """Messages that an agent received and did not use, by cause."""

    late: int = 0
    other_cycle: int = 0
    unexpected: int = 0
    duplicate: int = 0
    foreign: int = 0

    def total(self) -> int:
        """All of them."""
        return sum(vars(self).values())


class Sequencer(Generic[S]):
    """One agent on its way through the cycles.

    Arming rounds are cycles below 0. Each begins from the initial state and leaves no trace, and a
    message of a later round ends the one under way. From cycle 0 on, cycles follow one another.

    Parameters
    ----------
    agent
        The agent.
    sim_time_ns
        Simulated time of a cycle's beginning.
    lockstep
        Whether there is no clock: timed stages close at once.
    horizon
        How many cycles ahead of this agent another one may be. What is further ahead is dropped.
    on_drop
        Called with a line of text for each message that is dropped in the cycles of the run.
    """

    def __init__(
        self,
        agent: Agent[S],
        sim_time_ns: Callable[[int], int],
        *,
        lockstep: bool,
        horizon: int,
        on_drop: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.agent = agent
        self.drops = Drops()
        self.cycle = BEFORE_ARMING
        self.end_cycle: int | None = None
        self.missing_inputs = 0
        self._sim_time_ns = sim_time_ns
        self._lockstep = lockstep
        self._horizon = horizon
        self._on_drop = on_drop
        self._state = agent.initial_state()
        self._stages: tuple[Stage, ...] = ()
        self._place = 0
        self._stage_of: dict[Port[Message], int] = {}
        self._known_places: dict[tuple[Stage, ...], dict[Port[Message], int]] = {}
        self._inputs: dict[Port[Message], Message] = {}
        self._ahead: dict[int, list[Delivery]] = {}
        self._absent: tuple[str, ...] = ()
        self._waiting: set[Port[Message]] = set()
        self._deadline_passed = False

    @property
    def waiting_for(self) -> frozenset[Port[Message]]:
        """Ports whose messages the open stage still needs. Empty: no stage is open."""
        return frozenset(self._waiting)

    @property
    def wanted(self) -> int:
        """How many messages the open stage needs at least, 1 or more."""
        return len(self._waiting) or 1

    @property
    def stage(self) -> str:
        """Name of the open stage, empty if none is open."""
        return self._stages[self._place].name if self._place < len(self._stages) else ""

    @property
    def finished(self) -> bool:
        """Whether the run has ended for this agent."""
        return self.end_cycle is not None and self.cycle >= self.end_cycle

    def accept(self, port: Port[Message], message: Message) -> list[Delivery]:
        """Take in a message, and return what the agent sends in answer, if that closes a stage."""
        if not self.is_genuine(port, message):
            return []
        if message.cycle == self.cycle:
            return self._take(port, message)
        if message.cycle < self.cycle:
            self._drop("late", f"{port} is of cycle {message.cycle}, this is {self.cycle}")
            return []
        if self.cycle < 0 and message.cycle <= self._horizon:
            # A later arming round ends the one under way; the run's first message begins cycle 0.
            outputs = self.enter(min(message.cycle, 0))
            return outputs + self.accept(port, message)
        if message.cycle > max(self.cycle, 0) + self._horizon:
            self._drop("other_cycle", f"{port} is of cycle {message.cycle}, this is {self.cycle}")
            return []
        self._ahead.setdefault(message.cycle, []).append((port, message))
        return []

    def is_genuine(self, port: Port[Message], message: Message) -> bool:
        """Whether a message is from the one who may publish on its port; else it is dropped."""
        if message.source == port.publisher:
            return True
        self._drop("foreign", f"{port} of cycle {message.cycle} is from {message.source!r}")
        return False

    def enter(self, cycle: int) -> list[Delivery]:
        """Begin an arming round or cycle 0, from the initial state. The next cycles follow."""
        self._state = self.agent.initial_state()
        self._ahead = {ahead: held for ahead, held in self._ahead.items() if ahead >= cycle}
        self._begin(cycle)
        return self._advance()

    def end_before(self, cycle: int) -> None:
        """Let the run end before a cycle: those up to it are still completed."""
        self.end_cycle = cycle

    def close_stage(self) -> list[Delivery]:
        """Close the open stage with what has arrived, because its deadline has passed."""
        if not self.stage:
            return []
        absent = sorted(str(port) for port in self._waiting)
        self._absent += tuple(absent)
        self.missing_inputs += len(absent)
        self._waiting = set()
        self._deadline_passed = True
        return self._advance()

    def _take(self, port: Port[Message], message: Message) -> list[Delivery]:
        if not self._keep(port, message) or port not in self._waiting:
            return []
        self._waiting.discard(port)
        self._await_announced(port, message)
        return [] if self._waiting else self._advance()

    def _keep(self, port: Port[Message], message: Message) -> bool:
        """Keep a message of this cycle for its stage, if there is one still to come."""
        if port in self._inputs:
            self._drop("duplicate", f"{port} of cycle {message.cycle} came twice")
        elif self._stage_of.get(port, -1) >= self._place:
            self._inputs[port] = message
            return True
        else:
            self._drop_out_of_turn(port, message)
        return False

    def _begin(self, cycle: int) -> None:
        """Set up a cycle, with the messages that came ahead of it."""
        self.cycle = cycle
        self._stages = () if self.finished else self.agent.stages(cycle)
        self._stage_of = self._stage_of_port()
        self._place = 0
        self._inputs = {}
        self._absent = ()
        for port, message in self._ahead.pop(cycle, ()):
            self._keep(port, message)
        self._open_stage()

    def _stage_of_port(self) -> dict[Port[Message], int]:
        """Place of the stage that each port belongs to, worked out once for each kind of cycle."""
        places = self._known_places.get(self._stages)
        if places is None:
            places = self._known_places[self._stages] = {
                port: place
                for place, stage in enumerate(self._stages)
                for port in stage.awaits | stage.on_need
            }
        return places

    def _open_stage(self) -> None:
        """See what the stage still needs; what came early may announce more."""
        self._waiting = set()
        if self._place == len(self._stages):
            return
        awaits = self._stages[self._place].awaits
        self._waiting = set(awaits.difference(self._inputs))
        if len(self._waiting) < len(awaits):
            for port in awaits.intersection(self._inputs):
                self._await_announced(port, self._inputs[port])

    def _await_announced(self, port: Port[Message], message: Message) -> None:
        announced = self.agent.follow_up(port, message)
        if announced is not None and announced not in self._inputs:
            self._waiting.add(announced)

    def _advance(self) -> list[Delivery]:
        """Step the agent on, through stages and cycles, up to a stage that lacks something."""
        outputs: list[Delivery] = []
        while not self._waiting:
            if self._place < len(self._stages):
                stage = self._stages[self._place]
                if stage.timed and self._on_the_clock and not self._deadline_passed:
                    break
                self._deadline_passed = False
                outputs += self._step(stage)
                self._place += 1
                self._open_stage()
            elif self.cycle >= 0 and not self.finished:
                self._begin(self.cycle + 1)
            else:
                break
        return outputs

    @property
    def _on_the_clock(self) -> bool:
        return not self._lockstep and self.cycle >= 0

    def _step(self, stage: Stage) -> list[Delivery]:
        sim_time_ns = self._sim_time_ns(self.cycle)
        stamp = (self.cycle, sim_time_ns, self.agent.name, self._absent)
        turn = Turn(stage.name, self.cycle, sim_time_ns, stamp, self._inputs)
        self._state, outputs = self.agent.step(self._state, turn)
        return outputs

    def _drop_out_of_turn(self, port: Port[Message], message: Message) -> None:
        if port in self._stage_of:
            self._drop("late", f"{port} of cycle {message.cycle} came after its deadline")
        else:
            self._drop("unexpected", f"{port} is not expected in cycle {message.cycle}")

    def _drop(self, cause: str, text: str) -> None:
        if self.cycle < 0 and cause not in {"foreign", "other_cycle"}:
            return  # Rounds overlap while links come up: that is what arming is for.
        setattr(self.drops, cause, getattr(self.drops, cause) + 1)
        self._on_drop(text)
