"""What an agent is: stages of a cycle, each a pure step from inputs to outputs.

An agent has no clock, bus, file, log or randomness inside. Whoever drives it (a process over
Zenoh, one process in memory, a recording) hands it the inputs of a stage once they are complete
or their deadline has passed, and sends out what it returns. The same inputs in the same cycle
give the same outputs, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import msgspec

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Request, Setpoint, Stamp
from bus_schemas.signals import Port

M = TypeVar("M", bound=Message)
S = TypeVar("S")


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A part of a cycle that an agent does in one go.

    Attributes
    ----------
    name
        What the agent does in it.
    awaits
        The ports of which it needs a message each.
    on_need
        Ports of which a message may come besides, if another one announces it.
    timed
        In real time the stage begins on the clock instead of with a message: it stays open until
        its deadline. In lockstep there is no clock, and it closes at once.
    takes_late
        Ports of which it awaits nothing in this cycle, but takes up the message of an earlier one
        that came too late for it. Such a stage always says something, so that a recording tells.
    """

    name: str
    awaits: frozenset[Port[Message]]
    on_need: frozenset[Port[Message]] = frozenset()
    timed: bool = False
    takes_late: frozenset[Port[Message]] = frozenset()


class Turn(msgspec.Struct, frozen=True, gc=False):
    """What an agent sees when a stage closes, and all it sees.

    Attributes
    ----------
    stage
        Name of the stage.
    cycle, sim_time_ns
        Number of the cycle and simulated time of its beginning.
    stamp
        The first fields of every message that the agent makes now.
    inputs
        The messages of this cycle by port; where one did not come in time, the newest late one of
        that port. A port without either was silent up to the deadline.
    """

    stage: str
    cycle: int
    sim_time_ns: int
    stamp: Stamp
    inputs: dict[Port[Message], Any]

    def get(self, port: Port[M]) -> M | None:
        """Return the message of a port, None if it was silent."""
        message: M | None = self.inputs.get(port)
        return message


class Agent(Protocol[S]):
    """One process of the team, as a value."""

    @property
    def name(self) -> str:
        """Name on the bus: `plant`, `central` or a node's path."""

    def initial_state(self) -> S:
        """State before cycle 0, and before each arming round."""

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages of a cycle, in their order."""

    def follow_up(self, port: Port[Message], message: Message) -> Port[Message] | None:
        """Return the port of which this message says that it will have one too, if any."""

    def step(self, state: S, turn: Turn) -> tuple[S, list[Delivery]]:
        """Close one stage: from state and inputs to the next state and the messages to send."""


def parents_word_kw(message: Request | Setpoint | None, last_kw: float, rating_kw: float) -> float:
    """Return the power that a parent names; where it is silent or makes no sense, the last one.

    NaN, a negative and more than the node's rating make no sense. (Shares that were worked out
    tier by tier may exceed a rating by a rounding error.)
    """
    if message is None or not 0.0 <= message.power_kw <= rating_kw * (1.0 + 1e-9):
        return last_kw
    return message.power_kw
