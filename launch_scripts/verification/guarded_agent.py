"""An agent whose faults are told from those of the verification: whatever it raises is its own.

What it says is taken as a listener would get it, by way of bytes: a value that cannot be sent, or
that no listener would accept, is a fault of the agent too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

from agents.agent import Agent, Stage, Turn
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode, encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port

State: TypeAlias = Any
"""What an agent remembers: its own business."""


class AgentFailure(Exception):  # noqa: N818 - what failed is the agent, not the program
    """An agent raised an error, or said what cannot be sent. The text names the error."""


class GuardedAgent:
    """An agent that may fail.

    Parameters
    ----------
    make
        Makes the agent.

    Raises
    ------
    AgentFailure
        It cannot be made; so do all methods, of what they ask the agent.
    """

    def __init__(self, make: Callable[[], Agent[Any]]) -> None:
        with _blamed():
            self._agent = make()
            self._name = self._agent.name

    def initial_state(self) -> State:
        """Return its state before cycle 0."""
        with _blamed():
            return self._agent.initial_state()

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages of a cycle."""
        with _blamed():
            stages = tuple(self._agent.stages(cycle))
            for stage in stages:
                if not isinstance(stage, Stage):
                    raise TypeError(f"a stage is {stage!r}")
            return stages

    def announced(
        self, stage: Stage, inputs: dict[Port[Message], Message]
    ) -> Iterator[Port[Message]]:
        """Yield the ports that the inputs of a stage announce."""
        with _blamed():
            for port in stage.awaits.intersection(inputs):
                announced = self._agent.follow_up(port, inputs[port])
                if announced is not None:
                    yield announced

    def step(self, state: State, turn: Turn) -> tuple[State, list[Delivery]]:
        """Close a stage; return the next state, and the messages as a listener gets them."""
        with _blamed():
            state, outputs = self._agent.step(state, turn)
            heard = [(port, decode(port.signal, encode(message))) for port, message in outputs]
            return state, heard


@contextmanager
def _blamed() -> Iterator[None]:
    try:
        yield
    except (Exception, SystemExit) as error:  # Whatever the code under test does is a finding.
        raise AgentFailure(f"{type(error).__name__}: {error}") from error
