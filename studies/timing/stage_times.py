"""When each stage of each agent closed in each cycle, read from a recording in real time.

Every message states when its stage could close (`ready_time_ns`) and when it went out
(`publish_time_ns`). All that `heliarch timing` reports follows from these two; docs/timing.md
defines each measure. The tick of cycle k is `run.start_time_ns + k x cycle_wall_ns`. Arming rounds
do not count.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.agent import Stage
from agents.cycle import STAGES, kind_of, stage_of
from agents.plan import START_WITHIN_NS, RunPlan
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Run
from bus_schemas.missing import parse_missing
from bus_schemas.signals import COMMAND, PRODUCTION, RUN, Port
from bus_schemas.tree import PLANT, ROOT
from recordings.read.missed_inputs import MissedInputs
from recordings.read.reader import RunReader

NEVER: Final = np.iinfo(np.int64).max


class _Head(msgspec.Struct, gc=False):
    """The fields of a message that timing needs; the rest is not decoded."""

    missing: tuple[str, ...]
    ready_time_ns: int
    publish_time_ns: int


_decode_head = msgspec.msgpack.Decoder(_Head).decode


@dataclass(frozen=True, slots=True, eq=False)
class MessageTimes:
    """The times of the messages of T cycles on P ports, up to the last cycle that the plant ended.

    `columns` has the column of each port. `tick_ns`, shape (T,), is the scheduled beginning of each
    cycle. `ready_ns` and `publish_ns`, shape (T, P), are what the messages state; 0: no message.
    `missing` is what they say of inputs that were older than due, by port and cycle; `missed` how
    many inputs each agent missed; `fastest_ns`, shape (P,), the shortest time from publishing to
    the recorder.
    """

    plan: RunPlan
    columns: dict[Port[Message], int]
    tick_ns: NDArray[np.int64]
    ready_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    missing: dict[Port[Message], dict[int, tuple[str, ...]]]
    missed: MissedInputs
    fastest_ns: NDArray[np.int64]

    def published_ns(self, port: Port[Message]) -> NDArray[np.int64]:
        """Return when the messages of a port went out, shape (T,); 0 where there is none."""
        return self.publish_ns[:, self.columns[port]]


class StageTimes:
    """One stage of one agent over T cycles. Its times are valid in cycles in which it closed.

    inputs, outputs: The A ports that it awaits or uses, and those on which it publishes.
    timed: Whether the clock alone closes it.
    closed, ready_ns, first_ns, last_ns, last: Whether it published anything, when it could close,
        when its first and its last message went out, and which that was, a place in `outputs`.
        Shape (T,).
    awaited, without, lacking: Which inputs it awaits, and which of these had not come when it
        closed, shape (T, A); and whether any had not come, shape (T,).
    input_ns, oldest_ns: When this cycle's message of each input went out, shape (T, A), 0 for none;
        when the oldest message that it used did, shape (T,), `NEVER` for none.
    completed_ns, cause: When the last awaited input that came in time went out, 0 for none; and
        which it is, a place in `inputs`. Shape (T,).
    """

    def __init__(
        self,
        messages: MessageTimes,
        agent: str,
        pattern: Sequence[Stage | None],
        outputs: list[Port[Message]],
    ) -> None:
        stages = [stage for stage in pattern if stage is not None]
        self.agent, self.name, self.timed = agent, stages[0].name, stages[0].timed
        self.outputs = outputs
        self.inputs = list(dict.fromkeys(p for s in stages for p in (*s.awaits, *s.uses)))
        cycle = np.arange(len(messages.tick_ns))
        turn = cycle % len(pattern)
        awaits = [stage.awaits if stage is not None else () for stage in pattern]
        self.awaited = np.array(
            [[port in awaited for port in self.inputs] for awaited in awaits], dtype=bool
        )[turn]
        columns = [messages.columns[port] for port in outputs]
        publish_ns = messages.publish_ns[:, columns]
        there = publish_ns > 0
        self.closed = there.any(axis=1) & np.array([stage is not None for stage in pattern])[turn]
        self.last = publish_ns.argmax(axis=1)
        self.last_ns = publish_ns.max(axis=1)
        self.first_ns = np.where(there, publish_ns, NEVER).min(axis=1)
        self.ready_ns = messages.ready_ns[cycle, np.take(columns, self.last)]
        self._see_inputs(messages)

    def _see_inputs(self, messages: MessageTimes) -> None:
        """Find which messages it used, and which one it waited for last."""
        cycles = len(messages.tick_ns)
        periods = np.array([messages.plan.period(port) for port in self.inputs], dtype=np.int64)
        used = np.arange(cycles)[:, None] // periods * periods
        late = np.zeros(self.awaited.shape, dtype=bool)
        places = {str(port): place for place, port in enumerate(self.inputs)}
        for output, port in enumerate(self.outputs):
            for cycle, entries in messages.missing.get(port, {}).items():
                # A stage's last message speaks for it.
                if cycle >= cycles or not self.closed[cycle] or self.last[cycle] != output:
                    continue
                for key, of_cycle in map(parse_missing, entries):
                    if key in places:
                        late[cycle, places[key]] = True
                        used[cycle, places[key]] = -1 if of_cycle is None else of_cycle
        self.without: NDArray[np.bool_] = np.logical_and(self.awaited, late)
        self.lacking: NDArray[np.bool_] = self.without.any(axis=1)
        self.input_ns = messages.publish_ns[:, [messages.columns[port] for port in self.inputs]]
        known = (used >= 0) & (used < cycles)
        used_ns = np.take_along_axis(self.input_ns, np.where(known, used, 0), axis=0)
        used_ns[~known | (used_ns == 0)] = NEVER
        self.oldest_ns = used_ns.min(axis=1, initial=NEVER)
        in_time = self.awaited & ~late & (self.input_ns < self.last_ns[:, None])
        in_time_ns = np.where(in_time, self.input_ns, 0)
        self.completed_ns = in_time_ns.max(axis=1, initial=0)
        self.cause = in_time_ns.argmax(axis=1) if self.inputs else self.last


def read_message_times(reader: RunReader) -> MessageTimes:
    plan, start_ns = reader.plan, _start_ns(reader)
    ports = [port for port in plan.keys.ports if port.signal.is_cyclic and port.signal.logged]
    columns = {port: column for column, port in enumerate(ports)}
    cycles, places, readies, publishes = (array("q") for _ in range(4))
    fastest_ns = [NEVER] * len(columns)
    missing: dict[Port[Message], dict[int, tuple[str, ...]]] = {}
    missed = MissedInputs(plan)
    for record in reader.records(columns, range(_end_cycle(reader))):
        try:
            head = _decode_head(record.payload)
        except msgspec.DecodeError as error:
            raise InputError(
                f"{reader.path}: {record.port}: {error}, expected a "
                f"{record.port.signal.type.__name__}"
            ) from None
        missed.see(record)
        # A device without this host's clock states 0, one with another clock an impossible time.
        earliest_ns = max(start_ns + (record.cycle - 1) * plan.cycle_wall_ns, 1)
        if record.publish_time_ns > record.log_time_ns or head.publish_time_ns < earliest_ns:
            continue
        column = columns[record.port]
        fastest_ns[column] = min(fastest_ns[column], record.log_time_ns - record.publish_time_ns)
        cycles.append(record.cycle)
        places.append(column)
        readies.append(head.ready_time_ns)
        publishes.append(head.publish_time_ns)
        if head.missing:
            missing.setdefault(record.port, {}).setdefault(record.cycle, head.missing)
    # Turned round, so that of a message that came twice the first one stays.
    cycle, place = np.array(cycles)[::-1], np.array(places)[::-1]
    ended = cycle[place == columns[PRODUCTION.of(ROOT)]]
    length = int(ended.max()) + 1 if len(ended) else 0
    kept = cycle < length
    ready_ns, publish_ns = (np.zeros((length, len(columns)), dtype=np.int64) for _ in range(2))
    ready_ns[cycle[kept], place[kept]] = np.array(readies)[::-1][kept]
    publish_ns[cycle[kept], place[kept]] = np.array(publishes)[::-1][kept]
    tick_ns = start_ns + np.arange(length) * plan.cycle_wall_ns
    fastest = np.array(fastest_ns, dtype=np.int64)
    return MessageTimes(plan, columns, tick_ns, ready_ns, publish_ns, missing, missed, fastest)


def stage_times(messages: MessageTimes) -> list[StageTimes]:
    """Return every stage of every agent: the plant first, the stages of an agent in their order."""
    plan = messages.plan
    outputs: dict[tuple[str, str], list[Port[Message]]] = {}
    for port in messages.columns:
        outputs.setdefault((port.publisher, stage_of(port, plan.tree)), []).append(port)
    return [
        StageTimes(
            messages,
            agent,
            [next((one for one in stages if one.name == name), None) for stages in pattern],
            outputs[agent, name],
        )
        for agent, pattern in stages_of_agents(plan).items()
        for name in STAGES[kind_of(agent, plan.tree)]
    ]


def _start_ns(reader: RunReader) -> int:
    """Return when cycle 0 was to begin."""
    launched = reader.metadata["run"].get("driver") != "simulate"
    runs = (m for _, m in reader.messages(RUN) if isinstance(m, Run) and m.state == "start")
    start = next(runs, None) if launched and not reader.plan.lockstep else None
    if start is None:
        raise InputError(
            f"{reader.path}: it does not say when cycle 0 began in real time, expected the "
            "recording of a run of `heliarch launch` or `timing` at a finite pace"
        )
    # Agents, too, ignore a start time that is far from now.
    is_far = abs(start.start_time_ns - start.publish_time_ns) > START_WITHIN_NS
    return start.publish_time_ns if is_far else start.start_time_ns


def _end_cycle(reader: RunReader) -> int:
    """Return the cycle before which all counts.

    An external plant goes on after Ctrl-C, when the controllers have left it.
    """
    plan = reader.plan
    if PLANT not in plan.external:
        return plan.cycles
    own = [leaf for leaf in plan.tree.leaves if leaf not in plan.external]
    last = dict.fromkeys(own, -1)
    for record in reader.records([COMMAND.of(leaf) for leaf in own]):
        last[record.port.node] = max(last[record.port.node], record.cycle)
    return min(last.values(), default=plan.cycles - 1) + 1
