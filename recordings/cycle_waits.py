"""Who waited for whom in a cycle, worked out from the publish times of a recording.

A message goes out when its agent has all that it needs. So of the inputs that it had by then, the
one that was published last is what it waited for: its cause. From the plant's production, which
ends a cycle, the causes lead back to the tick that began it: that chain made the cycle as long as
it was, whatever happened beside it.

A wait lasts from the publishing of the cause to the publishing of the message. That holds the hop
between the two agents as well as the decision: a recording is a view from outside.

A device may not know this host's clock, and says so with a publish time of 0. What it publishes
then has no place here, nor has what claims to be from before the cycle before its own, or to have
been published after the recorder had it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from heapq import nlargest
from typing import Final, NamedTuple, TypeAlias

from msgspec import DecodeError

from agents.plan import START_WITHIN_NS
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Run
from bus_schemas.missing import SKIPPED, absence, skipped_cycles
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    PRODUCTION,
    REQUEST,
    RUN,
    SETPOINT,
    SIGNALS,
    TELEMETRY,
    Port,
    listeners,
)
from bus_schemas.tree import CENTRAL, ROOT, ControlTree
from recordings.reader import RunReader

CycleMessages: TypeAlias = dict[Port[Message], Message]

_CYCLIC: Final = tuple(signal for signal in SIGNALS if signal.is_cyclic)

_STAGES: Final = {
    TELEMETRY: "begin",
    DISPATCH: "begin",
    REQUEST: "request",
    SETPOINT: "solve",
    COMMAND: "actuate",
    PRODUCTION: "advance",
}
"""Stage that a signal comes from, where that does not depend on who says it."""

_HELD_CYCLES: Final = 300
"""How many cycles a message may come late and still be found with those of its own."""

_DOING: Final = {
    "begin": "to begin the cycle",
    "request": "to pass the request on",
    "estimate": "to estimate",
    "report": "to report",
    "solve": "to solve",
    "actuate": "to command",
    "advance": "to go on",
}


class Wait(NamedTuple):
    """A stage of an agent: from what it waited for to its own last message.

    Attributes
    ----------
    agent, stage
        Whose, and which.
    cause
        The input that came last; None: the agent went by the clock.
    message
        What it published in the end.
    began_ns, ended_ns
        When the two were published, after the cycle's scheduled tick [ns].
    without
        Keys of inputs that it waited for in vain, up to its deadline.
    given_up
        Whether it had fallen behind, and gave the cycle up: it waited for nobody.
    """

    agent: str
    stage: str
    cause: Port[Message] | None
    message: Port[Message]
    began_ns: int
    ended_ns: int
    without: tuple[str, ...]
    given_up: bool = False

    @property
    def length_ns(self) -> int:
        """How long it took [ns]."""
        return self.ended_ns - self.began_ns

    def in_words(self) -> str:
        """Say it: `c2/inv09 took 18.4 ms to estimate`."""
        if self.given_up:
            return f"{self.agent} gave the cycle up"
        took = f"{self.agent} took {self.length_ns / 1e6:.1f} ms {_DOING[self.stage]}"
        return f"{took}, without {', '.join(self.without)}" if self.without else took


class CycleWaits(NamedTuple):
    """The waits of one cycle.

    Attributes
    ----------
    cycle
        Its number.
    loop_ns
        From the scheduled tick to the plant's production [ns].
    chain
        The waits that made it so long, from the tick on.
    waits
        All of them, those of the chain too: one for each stage of each agent that spoke.
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


class WaitFinder:
    """Finds the waits of the cycles of a plant.

    Parameters
    ----------
    tree
        Its control tree.
    start_time_ns, cycle_wall_ns
        When cycle 0 began on the clock of the publish times, and the length of a cycle [ns].
    """

    def __init__(self, tree: ControlTree, start_time_ns: int, cycle_wall_ns: int) -> None:
        self._tree = tree
        self._start_time_ns = start_time_ns
        self._cycle_wall_ns = cycle_wall_ns
        self._heard: dict[str, list[Port[Message]]] = defaultdict(list)
        for signal in _CYCLIC:
            for node in signal.nodes(tree):
                port = signal.of(node)
                for agent in listeners(port, tree):
                    self._heard[agent].append(port)

    def tick_ns(self, cycle: int) -> int:
        """Return the scheduled beginning of a cycle."""
        return self._start_time_ns + cycle * self._cycle_wall_ns

    def of_cycle(self, cycle: int, messages: CycleMessages) -> CycleWaits:
        """Return the waits of a cycle, of which these are the messages.

        Raises
        ------
        InputError
            The plant's production is not among them.
        """
        production = messages.get(PRODUCTION.of(ROOT))
        if production is None:
            raise InputError(f"cycle {cycle}: the plant did not end it, accepted is a whole cycle")
        waits = tuple(self.waits(cycle, messages))
        by_place = {(wait.agent, wait.stage): wait for wait in waits}
        chain = tuple(reversed(list(self._back_from(PRODUCTION.of(ROOT), messages, by_place))))
        return CycleWaits(cycle, production.publish_time_ns - self.tick_ns(cycle), chain, waits)

    def waits(
        self, cycle: int, messages: CycleMessages, agents: Collection[str] = ()
    ) -> Iterator[Wait]:
        """Yield the waits of a cycle: of some agents, or of all that spoke."""
        last: dict[tuple[str, str], Port[Message]] = {}
        for port, message in messages.items():
            place = port.publisher, stage_of(port, self._tree)
            if agents and port.publisher not in agents:
                continue
            if place not in last or message.publish_time_ns > messages[last[place]].publish_time_ns:
                last[place] = port
        for (agent, stage), port in last.items():
            yield self._wait(cycle, agent, stage, port, messages)

    def _wait(
        self, cycle: int, agent: str, stage: str, port: Port[Message], messages: CycleMessages
    ) -> Wait:
        tick_ns = self.tick_ns(cycle)
        ended_ns = messages[port].publish_time_ns
        if _gave_up(messages[port]):
            return Wait(agent, stage, None, port, 0, ended_ns - tick_ns, (), given_up=True)
        without = self._without(agent, stage, port, messages)
        cause = self._cause(agent, port, messages, messages[port].publish_time_ns)
        began_ns = tick_ns if cause is None else messages[cause].publish_time_ns
        return Wait(agent, stage, cause, port, began_ns - tick_ns, ended_ns - tick_ns, without)

    def _cause(
        self, agent: str, port: Port[Message], messages: CycleMessages, before_ns: int
    ) -> Port[Message] | None:
        """Return what an agent had heard last before a time, and used in what it published."""
        absent = _absent(messages[port])
        candidates = [
            heard
            for heard in self._heard[agent]
            if heard in messages
            and messages[heard].publish_time_ns < before_ns
            and str(heard) not in absent
        ]
        return max(candidates, key=lambda heard: messages[heard].publish_time_ns, default=None)

    def _without(
        self, agent: str, stage: str, port: Port[Message], messages: CycleMessages
    ) -> tuple[str, ...]:
        """Return the inputs that were absent at this stage, and not already at one before it."""
        earlier: set[str] = set()
        for other, message in messages.items():
            in_another = stage_of(other, self._tree) != stage
            before = message.publish_time_ns < messages[port].publish_time_ns
            if other.publisher == agent and in_another and before:
                earlier |= _absent(message)
        return tuple(sorted(_absent(messages[port]) - earlier))

    def _back_from(
        self,
        port: Port[Message],
        messages: CycleMessages,
        waits: Mapping[tuple[str, str], Wait],
    ) -> Iterator[Wait]:
        """Follow the causes from a message back to the tick.

        Where a stage ended at its deadline, what came too late for it is the cause, up to the
        moment at which nobody waited for it any more: no link outlasts the one that it caused.
        """
        seen: set[tuple[str, str]] = set()
        followed: Port[Message] | None = port
        until_ns = messages[port].publish_time_ns
        while followed is not None:
            place = followed.publisher, stage_of(followed, self._tree)
            if place in seen:
                return
            seen.add(place)
            wait = waits[place]._replace(message=followed)
            until_ns = min(messages[followed].publish_time_ns, until_ns)
            tick_ns = self.tick_ns(messages[followed].cycle)
            cause = None
            if not wait.given_up:
                cause = self._late_cause(wait, messages)
                cause = cause or self._cause(wait.agent, followed, messages, until_ns)
            began_ns = tick_ns if cause is None else messages[cause].publish_time_ns
            began_ns = min(began_ns, until_ns)
            yield wait._replace(
                cause=cause, began_ns=began_ns - tick_ns, ended_ns=until_ns - tick_ns
            )
            followed = cause

    def _late_cause(self, wait: Wait, messages: CycleMessages) -> Port[Message] | None:
        """Return the last of the messages that a stage waited for in vain; None: none ever came."""
        late = [port for port in messages if str(port) in wait.without]
        return max(late, key=lambda port: messages[port].publish_time_ns, default=None)


def stage_of(port: Port[Message], tree: ControlTree) -> str:
    """Return the stage of its publisher that a message comes from."""
    stage = _STAGES.get(port.signal)
    if stage is not None:
        return stage
    if port.publisher == CENTRAL:
        return "solve"
    return "estimate" if tree.is_leaf(port.node) else "report"


def slowest_cycles(
    reader: RunReader, count: int, last_cycle: int | None = None
) -> list[CycleWaits]:
    """Return the slowest cycles of a run in real time, up to a cycle, the slowest first.

    Raises
    ------
    InputError
        The run was not in real time, or its recording does not say when it began.
    """
    finder = wait_finder(reader)
    loops_ns = _loops_ns(reader, finder, last_cycle)
    slowest = nlargest(count, loops_ns, key=lambda cycle: loops_ns[cycle])
    return [finder.of_cycle(cycle, _messages_of(reader, finder, cycle)) for cycle in slowest]


def loop_times_ns(reader: RunReader, last_cycle: int | None = None) -> list[int]:
    """Return from each cycle the time from its scheduled tick to the plant's production [ns].

    Those are left out in which the plant does not tell a possible time.
    """
    return list(_loops_ns(reader, wait_finder(reader), last_cycle).values())


def last_cycle_with_all(reader: RunReader, agents: Collection[str]) -> int:
    """Return the last cycle in which each of these inverters gave a command; -1: there is none."""
    last = dict.fromkeys(agents, -1)
    for record in reader.records([COMMAND.of(agent) for agent in agents]):
        last[record.port.node] = max(last[record.port.node], record.cycle)
    return min(last.values(), default=-1)


def response_times_ns(
    reader: RunReader, agents: Collection[str], last_cycle: int | None = None
) -> dict[tuple[str, str], list[int]]:
    """Return how long some agents took to answer, by agent and stage [ns].

    That is from the last input that was published before their own last message of a stage. Where
    their publish times are not known or impossible there is nothing to tell.
    """
    finder = wait_finder(reader)
    found: dict[tuple[str, str], list[int]] = defaultdict(list)
    if not agents:
        return found
    for cycle, messages in _by_cycle(reader, finder, last_cycle):
        for wait in finder.waits(cycle, messages, agents):
            found[wait.agent, wait.stage].append(wait.length_ns)
    return found


def wait_finder(reader: RunReader) -> WaitFinder:
    """Return what finds the waits of a recording.

    Raises
    ------
    InputError
        The run was not in real time, or its recording does not say when it began.
    """
    plan = reader.plan
    for _, message in reader.messages(RUN):
        if isinstance(message, Run) and message.state == "start" and not plan.lockstep:
            return WaitFinder(plan.tree, _began_ns(message), plan.cycle_wall_ns)
    raise InputError(
        f"{reader.path}: it does not say when cycle 0 began in real time, accepted is the recording"
        " of a run at a finite pace"
    )


def _began_ns(start: Run) -> int:
    """Return when cycle 0 began: with the word of it where that names an impossible time.

    The agents believe no such word either.
    """
    is_far = abs(start.start_time_ns - start.publish_time_ns) > START_WITHIN_NS
    return start.publish_time_ns if is_far and start.publish_time_ns else start.start_time_ns


def _loops_ns(reader: RunReader, finder: WaitFinder, last_cycle: int | None) -> dict[int, int]:
    """Return the time from the scheduled tick to the plant's production, by cycle [ns]."""
    found: dict[int, int] = {}
    for _, message in _in_time(reader, finder, [PRODUCTION.of(ROOT)], _up_to(last_cycle)):
        loop_ns = message.publish_time_ns - finder.tick_ns(message.cycle)
        found.setdefault(message.cycle, loop_ns)  # Of one that came twice the first counts.
    return found


def _messages_of(reader: RunReader, finder: WaitFinder, cycle: int) -> CycleMessages:
    messages: CycleMessages = {}
    cycles = range(cycle, cycle + 1)
    for port, message in _in_time(reader, finder, _cyclic_ports(reader), cycles):
        messages.setdefault(port, message)  # Of one that came twice the first counts.
    return messages


def _by_cycle(
    reader: RunReader, finder: WaitFinder, last_cycle: int | None
) -> Iterator[tuple[int, CycleMessages]]:
    """Yield the messages of each cycle. What comes late is still found: memory holds few cycles."""
    held: dict[int, CycleMessages] = defaultdict(dict)
    for port, message in _in_time(reader, finder, _cyclic_ports(reader), _up_to(last_cycle)):
        held[message.cycle].setdefault(port, message)
        if len(held) > _HELD_CYCLES:
            oldest = min(held)
            yield oldest, held.pop(oldest)
    yield from sorted(held.items())


def _in_time(
    reader: RunReader, finder: WaitFinder, ports: Collection[Port[Message]], cycles: range
) -> Iterator[Delivery]:
    """Yield the messages of some cycles whose publish times are known and possible."""
    for record in reader.records(ports, cycles):
        if record.publish_time_ns > record.log_time_ns:
            continue
        try:
            message = decode(record.port.signal, record.payload)
        except DecodeError as error:
            raise InputError(
                f"{reader.path}: {record.port}: {error}, accepted is a "
                f"{record.port.signal.type.__name__}"
            ) from None
        if message.publish_time_ns >= max(finder.tick_ns(message.cycle - 1), 1):
            yield record.port, message


def _up_to(last_cycle: int | None) -> range:
    return range(sys.maxsize if last_cycle is None else last_cycle + 1)


def _cyclic_ports(reader: RunReader) -> Sequence[Port[Message]]:
    return [signal.of(node) for signal in _CYCLIC for node in signal.nodes(reader.plan.tree)]


def _gave_up(message: Message) -> bool:
    """Whether the sender says that it gave up the cycle of this very message."""
    return message.cycle in skipped_cycles(message.missing, message.cycle)


def _absent(message: Message) -> set[str]:
    """Keys of the inputs of its cycle that a message was decided without."""
    return {found.key for found in map(absence, message.missing) if found.key != SKIPPED}
