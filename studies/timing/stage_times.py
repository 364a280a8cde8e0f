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
from itertools import compress
from typing import NamedTuple

import numpy as np
import pandas as pd

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


@dataclass(frozen=True, slots=True, eq=False)
class MessageTimes:
    """The times of the messages of a run, up to the last cycle that the plant ended.

    `ready_ns` and `publish_ns` have a row for each cycle and a column for each port: the times that
    the messages state, from the scheduled tick of their cycle; NaN: no message, or no time in it.
    `missing` are the inputs older than due that they state, by cycle and port; `missed` is how many
    inputs each agent missed; `fastest_ns` is the shortest time from publishing to the recorder.
    """

    plan: RunPlan
    ports: Sequence[Port[Message]]
    ready_ns: pd.DataFrame
    publish_ns: pd.DataFrame
    missing: dict[tuple[int, Port[Message]], tuple[str, ...]]
    missed: MissedInputs
    fastest_ns: dict[Port[Message], int]


class StageTimes(NamedTuple):
    """One stage of one agent; `closed` has a row for each cycle in which it published anything.

    Its columns, with times from the scheduled tick of the cycle (NaN: none):

    first_ns, last_ns, message: When its first and last messages went out, and the last one's port.
    ready_ns: When it could close.
    completed_ns: When the last awaited input that came in time went out.
    oldest_ns: When the oldest message that it used went out, perhaps in an earlier cycle.
    awaits, lacking, overran: Whether it awaits anything in this cycle; whether it closed without an
        awaited input; whether it had them all, but published after its deadline.
    without: Keys of the inputs that had not come.
    cause: What it waited for last: the input that completed it, or that came too late. None: that
        is not known.
    """

    agent: str
    name: str
    deadline_ns: int
    timed: bool
    closed: pd.DataFrame


def read_message_times(reader: RunReader) -> MessageTimes:
    plan, start_ns = reader.plan, _start_ns(reader)
    ports = [port for port in plan.wiring.ports if port.signal.is_cyclic and port.signal.logged]
    columns = {port: column for column, port in enumerate(ports)}
    cycles, places, readies, publishes = (array("q") for _ in range(4))
    fastest_ns: dict[Port[Message], int] = {}
    missing: dict[tuple[int, Port[Message]], tuple[str, ...]] = {}
    missed = MissedInputs(plan)
    for record in reader.records(columns, range(_end_cycle(reader))):
        port, cycle = record.port, record.cycle
        message = record.message()
        missed.count(port, message)
        # A device without this host's clock states 0, one with another clock an impossible time.
        earliest_ns = max(start_ns + (cycle - 1) * plan.cycle_wall_ns, 1)
        if record.publish_time_ns > record.log_time_ns or message.publish_time_ns < earliest_ns:
            continue
        way_ns = record.log_time_ns - record.publish_time_ns
        fastest_ns[port] = min(fastest_ns.get(port, way_ns), way_ns)
        cycles.append(cycle)
        places.append(columns[port])
        readies.append(message.ready_time_ns)
        publishes.append(message.publish_time_ns)
        if message.missing:
            missing.setdefault((cycle, port), message.missing)
    found = {"cycle": cycles, "place": places, "ready_ns": readies, "publish_ns": publishes}
    # The first of two copies of a message is kept.
    frame = pd.DataFrame(found, dtype=np.int64).drop_duplicates(["cycle", "place"])
    ended = frame.cycle[frame.place == columns[PRODUCTION.of(ROOT)]]
    length = int(ended.max()) + 1 if len(ended) else 0
    frame = frame.set_index(["cycle", "place"])
    tick_ns = start_ns + frame.index.get_level_values("cycle") * plan.cycle_wall_ns

    def table(time_ns: pd.Series) -> pd.DataFrame:
        """Lay times out by cycle and port, from the tick of their cycle."""
        shown = (time_ns - tick_ns).where(time_ns > 0).unstack().reindex(range(length))
        return shown.reindex(columns=range(len(ports))).set_axis(ports, axis=1)

    return MessageTimes(
        plan, ports, table(frame.ready_ns), table(frame.publish_ns), missing, missed, fastest_ns
    )


def stage_times(messages: MessageTimes) -> list[StageTimes]:
    """Return every stage of every agent: the plant first, the stages of an agent in their order."""
    plan = messages.plan
    outputs: dict[tuple[str, str], list[Port[Message]]] = {}
    for port in messages.ports:
        outputs.setdefault((port.publisher, stage_of(port, plan.tree)), []).append(port)
    return [
        _stage(
            messages,
            agent,
            [next((one for one in stages if one.name == name), None) for stages in pattern],
            outputs[agent, name],
        )
        for agent, pattern in stages_of_agents(plan).items()
        for name in STAGES[kind_of(agent, plan.tree)]
    ]


def _stage(
    messages: MessageTimes,
    agent: str,
    pattern: Sequence[Stage | None],
    outputs: Sequence[Port[Message]],
) -> StageTimes:
    """Return a stage; `pattern` is the stage in each cycle until that repeats, None: not there."""
    plan = messages.plan
    stages = [stage for stage in pattern if stage is not None]
    name, timed = stages[0].name, stages[0].timed
    publish_ns = messages.publish_ns[outputs]
    turn = np.arange(len(publish_ns)) % len(pattern)
    closes = np.array([stage is not None for stage in pattern])[turn]
    publish_ns = publish_ns[closes & publish_ns.notna().any(axis=1)]
    cycle, last_ns = publish_ns.index.to_numpy(), publish_ns.max(axis=1)
    last = np.nanargmax(publish_ns.to_numpy(), axis=1)
    message = np.array(outputs, dtype=object)[last]

    # For each cycle and input: whether it is awaited, whether it was late, and the cycle of the
    # message that was used.
    inputs = list(dict.fromkeys(port for one in stages for port in (*one.awaits, *one.uses)))
    awaits = [() if stage is None else stage.awaits for stage in pattern]
    awaited = np.array([[port in ports for port in inputs] for ports in awaits], dtype=bool)
    awaited = awaited[cycle % len(pattern)]
    periods = np.array([plan.period(port) for port in inputs], dtype=np.int64)
    used = cycle[:, None] // periods * periods
    late = np.zeros(awaited.shape, dtype=bool)
    places = {str(port): place for place, port in enumerate(inputs)}
    # A stage's last message states what was missing.
    for row, closing in enumerate(zip(cycle.tolist(), message, strict=True)):
        for key, of_cycle in map(parse_missing, messages.missing.get(closing, ())):
            if key in places:
                late[row, places[key]] = True
                used[row, places[key]] = -1 if of_cycle is None else of_cycle
    without = awaited & late
    lacking = without.any(axis=1)

    sent_ns = messages.publish_ns[inputs].to_numpy(dtype=float)
    known = (used >= 0) & (used < len(sent_ns))
    used_ns = np.take_along_axis(sent_ns, np.where(known, used, 0), axis=0)
    used_ns += (used - cycle[:, None]) * plan.cycle_wall_ns
    input_ns = sent_ns[cycle]
    in_time = awaited & ~late & (input_ns < last_ns.to_numpy()[:, None])
    waited_for = np.where(lacking[:, None], without, in_time) & ~np.isnan(input_ns)
    # The first column stands for no input.
    nothing_ns = np.full(len(cycle), -np.inf)
    waited_ns = np.column_stack([nothing_ns, np.where(waited_for, input_ns, -np.inf)])
    deadline_ns = plan.deadlines.deadline_ns(agent, name)
    # The plant's tick is when its first stage begins, not when it must end.
    grace_ns = plan.deadlines.slice_ns(agent, name) if timed else 0
    columns = {
        "first_ns": publish_ns.min(axis=1),
        "last_ns": last_ns,
        "message": message,
        "ready_ns": messages.ready_ns[outputs].to_numpy()[cycle, last],
        "completed_ns": np.fmax.reduce(np.where(in_time, input_ns, np.nan), 1, initial=np.nan),
        "oldest_ns": np.fmin.reduce(np.where(known, used_ns, np.nan), 1, initial=np.nan),
        "awaits": awaited.any(axis=1),
        "lacking": lacking,
        "overran": ~lacking & (last_ns > deadline_ns + grace_ns),
        "without": [tuple(sorted(compress(places, row))) for row in without.tolist()],
        "cause": np.array([None, *inputs], dtype=object)[waited_ns.argmax(axis=1)],
    }
    return StageTimes(agent, name, deadline_ns, timed, pd.DataFrame(columns))


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
    """Return the first cycle that does not count.

    An external plant goes on after Ctrl-C, when the controllers have left it.
    """
    plan = reader.plan
    if PLANT not in plan.external:
        return plan.cycles
    own = [COMMAND.of(leaf) for leaf in plan.tree.leaves if leaf not in plan.external]
    last = {record.port: record.cycle for record in reader.records(own)}
    return min(last.values(), default=plan.cycles - 1) + 1
