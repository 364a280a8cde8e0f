"""An agent: stages of a cycle, each a pure step from inputs to outputs.

It has no clock, bus, file, log or randomness inside. The same inputs in the same cycle give the
same outputs, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import msgspec

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Stamp
from bus_schemas.signals import Port

M = TypeVar("M", bound=Message)
S = TypeVar("S")


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """One step of an agent in a cycle.

    awaits: It needs the message of this cycle on these ports.
    uses: It also uses the newest message on these ports.
    timed: In real time the stage closes at its deadline and never before.
    """

    name: str
    awaits: tuple[Port[Message], ...]
    uses: tuple[Port[Message], ...] = ()
    timed: bool = False


class Turn(msgspec.Struct, frozen=True, gc=False):
    """All that an agent sees when a stage closes.

    stamp: The first fields of every message that the agent makes now.
    inputs: The newest message of each port that the stage awaits or uses; None if there was none,
        or it is too old. Of orders: a tuple of all that have come, in the order of time.
    """

    stage: str
    cycle: int
    sim_time_ns: int
    stamp: Stamp
    inputs: dict[Port[Message], Any]

    def get(self, port: Port[M]) -> M | None:
        """Return the newest message of a port, None if it has expired."""
        message: M | None = self.inputs[port]
        return message


class Agent(Protocol[S]):
    """One member of the team. The plant may not skip cycles, unless it is far behind."""

    may_skip: bool

    @property
    def name(self) -> str:
        """Return the name on the bus: `plant`, `central` or a node's path."""

    def initial_state(self) -> S:
        """State before cycle 0, and before each arming round."""

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages of a cycle, in their order."""

    def step(self, state: S, turn: Turn) -> tuple[S, list[Delivery]]:
        """Close one stage: from state and inputs to the next state and the messages to send.

        A stage that changes the state always sends something, so that a recording shows it.
        """
