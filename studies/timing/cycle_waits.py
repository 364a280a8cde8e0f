"""Who waited for whom in a cycle, worked out from the publish times of its messages.

A stage closes when it has every input that it awaits, so the input published last is its cause.
From the plant's production, which ends a cycle, the causes lead back to the tick: this chain made
the cycle as long as it was. A wait lasts from the publishing of the cause to the publishing of the
message; it includes the hop between the two agents and the decision.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from agents.cycle import stage_of
from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, Port
from bus_schemas.tree import ROOT, some_of
from studies.timing.stage_times import MessageTimes, StageTimes

_DOING: Final = {
    "sense": "to begin the cycle",
    "estimate": "to estimate",
    "report": "to report",
    "solve": "to solve",
    "actuate": "to command",
    "apply": "to apply the commands",
}


class Wait(NamedTuple):
    """A stage of an agent, from what it waited for to its own last message.

    It began when its `cause`, the input published last, was published, and ended with its last
    `message`; both times are after the cycle's scheduled tick [ns]. Without a cause the clock
    closed it. `without` are the keys of inputs that had not come at its deadline.
    """

    agent: str
    stage: str
    cause: Port[Message] | None
    message: Port[Message]
    began_ns: int
    ended_ns: int
    without: tuple[str, ...]

    @property
    def length_ns(self) -> int:
        return self.ended_ns - self.began_ns

    def in_words(self) -> str:
        """Return a phrase such as `c2/inv09 took 18.4 ms to estimate`."""
        took = f"{self.agent} took {self.length_ns / 1e6:.1f} ms {_DOING[self.stage]}"
        return f"{took}, without {some_of(self.without, 3)}" if self.without else took


class CycleWaits(NamedTuple):
    """The waits of one cycle, from the scheduled tick to the plant's production.

    The `chain` made it so long; `waits` has all stages that published, those of the chain included.
    """

    cycle: int
    loop_ns: int
    chain: tuple[Wait, ...]
    waits: tuple[Wait, ...]

    @property
    def slowest(self) -> Wait:
        return max(self.chain, key=lambda wait: wait.length_ns)

    def in_words(self) -> str:
        """Say which link made the cycle long."""
        return f"cycle {self.cycle:,}: {self.loop_ns / 1e6:.1f} ms, {self.slowest.in_words()}"


def cycle_waits(messages: MessageTimes, stages: Iterable[StageTimes], cycle: int) -> CycleWaits:
    """Return the waits of a cycle that the plant has ended."""
    found = _Cycle(messages, stages, cycle)
    chain = tuple(found.chain())[::-1]
    waits = tuple(found.wait(stage, found.last(stage)) for stage in found.stages)
    return CycleWaits(cycle, chain[-1].ended_ns, chain, waits)


class _Cycle:
    """One cycle of a run; times are after its scheduled tick [ns]."""

    def __init__(self, messages: MessageTimes, stages: Iterable[StageTimes], cycle: int) -> None:
        self._messages = messages
        self._cycle = cycle
        self.stages = [stage for stage in stages if stage.closed[cycle]]

    def chain(self) -> Iterator[Wait]:
        """Follow the causes from the plant's production back to the tick.

        A message that came too late counts up to the moment when nobody waited for it any more.
        """
        by_name = {(stage.agent, stage.name): stage for stage in self.stages}
        message: Port[Message] | None = PRODUCTION.of(ROOT)
        until_ns: int | None = None
        while message is not None:
            place = message.publisher, stage_of(message, self._messages.plan.tree)
            stage = by_name.pop(place, None)
            if stage is None:
                return
            wait = self.wait(stage, message, until_ns)
            yield wait
            message, until_ns = wait.cause, wait.ended_ns

    def wait(self, stage: StageTimes, message: Port[Message], until_ns: int | None = None) -> Wait:
        """Return the wait of a stage up to one of its messages, at most up to a moment."""
        cause, began_ns, ended_ns = self._cause(stage), 0, self._published_ns(message)
        if until_ns is not None:
            ended_ns = min(ended_ns, until_ns)
        if cause is not None:
            began_ns = min(self._published_ns(cause), ended_ns)
        missing = np.flatnonzero(stage.without[self._cycle])
        without = tuple(sorted(str(stage.inputs[place]) for place in missing))
        return Wait(stage.agent, stage.name, cause, message, began_ns, ended_ns, without)

    def _cause(self, stage: StageTimes) -> Port[Message] | None:
        """Return what a stage waited for last; None if the clock closed it.

        For a stage that closed at its deadline this is the input that came too late. A stage that
        awaits nothing follows the agent's stage before it.
        """
        cycle = self._cycle
        if stage.lacking[cycle]:
            late_ns = np.where(stage.without[cycle], stage.input_ns[cycle], 0)
            return stage.inputs[int(late_ns.argmax())] if late_ns.any() else None
        if stage.awaited[cycle].any():
            came = stage.completed_ns[cycle] > 0
            return stage.inputs[int(stage.cause[cycle])] if came else None
        before = [
            other
            for other in self.stages
            if other.agent == stage.agent and other.last_ns[cycle] < stage.first_ns[cycle]
        ]
        return self.last(max(before, key=lambda other: other.last_ns[cycle])) if before else None

    def last(self, stage: StageTimes) -> Port[Message]:
        """Return where a stage published its last message."""
        return stage.outputs[int(stage.last[self._cycle])]

    def _published_ns(self, port: Port[Message]) -> int:
        return int((self._messages.published_ns(port) - self._messages.tick_ns)[self._cycle])
