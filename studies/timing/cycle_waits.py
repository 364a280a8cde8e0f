"""Who waited for whom in a cycle, worked out from the publish times of its messages.

A stage closes when it has every input that it awaits, so the input published last is its cause.
From the plant's production, which ends a cycle, the causes lead back to the tick: this chain made
the cycle as long as it was. A wait lasts from the publishing of the cause to the publishing of the
message; it includes the hop between the two agents and the decision.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple, TypeAlias

import msgspec

from agents.agent import Stage
from agents.cycle import stage_of
from agents.plan import RunPlan
from agents.team import controllers
from bus_schemas.messages import Message
from bus_schemas.missing import parse_missing
from bus_schemas.signals import COMMAND, PRODUCTION, Port
from bus_schemas.tree import PLANT, ROOT

_DOING: Final = {
    "sense": "to begin the cycle",
    "estimate": "to estimate",
    "report": "to report",
    "solve": "to solve",
    "actuate": "to command",
    "apply": "to apply the commands",
}

_MOST_NAMED: Final = 3
"""How many missing inputs a sentence names."""


class Head(msgspec.Struct, gc=False):
    """The fields of a message that timing needs; the rest is not decoded."""

    cycle: int
    missing: tuple[str, ...]
    ready_time_ns: int
    publish_time_ns: int


CycleHeads: TypeAlias = dict[Port[Message], Head]
"""The messages of one cycle."""


class Closing(NamedTuple):
    """A stage of one agent in one cycle, as its messages show it.

    Attributes
    ----------
    last
        The message that it published last.
    ready_ns
        When its last input had come or its deadline had passed.
    first_ns, last_ns
        When its first and its last message went out.
    missing
        Inputs that were older than due: the cycle of the message used, or None.
    """

    agent: str
    stage: Stage
    last: Port[Message]
    ready_ns: int
    first_ns: int
    last_ns: int
    missing: dict[str, int | None]

    @property
    def without(self) -> tuple[Port[Message], ...]:
        """The awaited inputs that did not come in this cycle."""
        if not self.missing:
            return ()
        return tuple(port for port in self.stage.awaits if str(port) in self.missing)

    def completed_by(self, heads: CycleHeads) -> Port[Message] | None:
        """Return the awaited input that was published last of those that came in time."""
        in_time = [
            port
            for port in self.stage.awaits
            if port in heads
            and heads[port].publish_time_ns < self.last_ns
            and not (self.missing and str(port) in self.missing)
        ]
        return max(in_time, key=lambda port: heads[port].publish_time_ns, default=None)


Closings: TypeAlias = dict[str, dict[str, Closing]]
"""The stages of one cycle, by agent and name."""


class Wait(NamedTuple):
    """A stage of an agent, from what it waited for to its own last message.

    Attributes
    ----------
    cause
        The input that was published last; None if the clock closed the stage.
    message
        What it published last.
    began_ns, ended_ns
        When cause and message were published, after the cycle's scheduled tick [ns].
    without
        Keys of inputs that had not come at its deadline.
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
        """How long it took [ns]."""
        return self.ended_ns - self.began_ns

    def in_words(self) -> str:
        """Return a phrase such as `c2/inv09 took 18.4 ms to estimate`."""
        took = f"{self.agent} took {self.length_ns / 1e6:.1f} ms {_DOING[self.stage]}"
        if not self.without:
            return took
        others = len(self.without) - _MOST_NAMED
        rest = f" and {others} more" if others > 0 else ""
        return f"{took}, without {', '.join(self.without[:_MOST_NAMED])}{rest}"


class CycleWaits(NamedTuple):
    """The waits of one cycle.

    Attributes
    ----------
    loop_ns
        From the scheduled tick to the plant's production [ns].
    chain
        The waits that made it so long, from the tick on.
    waits
        One for each stage of each agent that published, those of the chain included.
    """

    cycle: int
    loop_ns: int
    chain: tuple[Wait, ...]
    waits: tuple[Wait, ...]

    @property
    def slowest(self) -> Wait:
        """The longest wait of the chain."""
        return max(self.chain, key=lambda wait: wait.length_ns)

    def in_words(self) -> str:
        """Say which link made the cycle long."""
        return f"cycle {self.cycle:,}: {self.loop_ns / 1e6:.1f} ms, {self.slowest.in_words()}"


class StageTable:
    """The stages of each agent of a run, and which messages come from each."""

    def __init__(self, plan: RunPlan) -> None:
        commands = tuple(COMMAND.of(leaf) for leaf in plan.tree.leaves)
        self._plant = (Stage("sense", (), timed=True), Stage("apply", commands))
        self._team = {agent.name: agent.stages for agent in controllers(plan)}
        self.agents = (PLANT, *self._team)
        self.stage_of = {
            port: stage_of(port, plan.tree) for port in plan.keys.ports if port.signal.decided
        }

    def stages(self, agent: str, cycle: int) -> tuple[Stage, ...]:
        """Return an agent's stages of a cycle, in order."""
        return self._plant if agent == PLANT else self._team[agent](cycle)

    def closings(self, cycle: int, heads: CycleHeads) -> Closings:
        """Return the stages of a cycle that published something, by agent and stage."""
        ports: dict[tuple[str, str], list[Port[Message]]] = {}
        for port in heads:
            ports.setdefault((port.publisher, self.stage_of[port]), []).append(port)
        found: Closings = {}
        for agent in self.agents:
            for stage in self.stages(agent, cycle):
                published = ports.get((agent, stage.name))
                if published:
                    closing = _closing(agent, stage, published, heads)
                    found.setdefault(agent, {})[stage.name] = closing
        return found


def _closing(
    agent: str, stage: Stage, published: list[Port[Message]], heads: CycleHeads
) -> Closing:
    last = max(published, key=lambda port: heads[port].publish_time_ns)
    head = heads[last]
    first_ns = min(heads[port].publish_time_ns for port in published)
    missing = dict(map(parse_missing, head.missing))
    return Closing(agent, stage, last, head.ready_time_ns, first_ns, head.publish_time_ns, missing)


def cycle_waits(table: StageTable, cycle: int, tick_ns: int, heads: CycleHeads) -> CycleWaits:
    """Return the waits of a cycle that the plant has ended; `tick_ns` is its scheduled start."""
    closings = table.closings(cycle, heads)
    every = [closing for stages in closings.values() for closing in stages.values()]
    waits = tuple(
        _wait(closing, _cause(closing, heads, closings), closing.last_ns, tick_ns, heads)
        for closing in every
    )
    chain = tuple(reversed(list(_chain(table, tick_ns, heads, closings))))
    loop_ns = heads[PRODUCTION.of(ROOT)].publish_time_ns - tick_ns
    return CycleWaits(cycle, loop_ns, chain, waits)


def _chain(
    table: StageTable, tick_ns: int, heads: CycleHeads, closings: Closings
) -> Iterator[Wait]:
    """Follow the causes from the plant's production back to the tick.

    A message that came too late counts up to the moment when nobody waited for it any more.
    """
    seen: set[tuple[str, str]] = set()
    message: Port[Message] | None = PRODUCTION.of(ROOT)
    until_ns = heads[PRODUCTION.of(ROOT)].publish_time_ns
    while message is not None:
        place = message.publisher, table.stage_of[message]
        if place in seen:
            return
        seen.add(place)
        closing = closings[place[0]][place[1]]
        until_ns = min(heads[message].publish_time_ns, until_ns)
        cause = _cause(closing, heads, closings)
        yield _wait(closing, cause, until_ns, tick_ns, heads)._replace(message=message)
        message = cause


def _cause(closing: Closing, heads: CycleHeads, closings: Closings) -> Port[Message] | None:
    """Return what a stage waited for last; None if the clock closed it.

    For a stage that closed at its deadline this is the input that came too late. A stage that
    awaits nothing follows the agent's stage before it.
    """
    if late := [port for port in closing.without if port in heads]:
        return max(late, key=lambda port: heads[port].publish_time_ns)
    if closing.without:
        return None
    if closing.stage.awaits:
        return closing.completed_by(heads)
    before = [
        other for other in closings[closing.agent].values() if other.last_ns < closing.first_ns
    ]
    return max(before, key=lambda other: other.last_ns).last if before else None


def _wait(
    closing: Closing,
    cause: Port[Message] | None,
    until_ns: int,
    tick_ns: int,
    heads: CycleHeads,
) -> Wait:
    began_ns = tick_ns if cause is None else min(heads[cause].publish_time_ns, until_ns)
    return Wait(
        closing.agent,
        closing.stage.name,
        cause,
        closing.last,
        began_ns - tick_ns,
        until_ns - tick_ns,
        tuple(sorted(map(str, closing.without))),
    )
