"""When each stage of each agent closed in each cycle, read from a recording in real time.

Every message states when its stage could close (`ready_time_ns`) and when it went out
(`publish_time_ns`). All that `heliarch timing` reports follows from these two; docs/timing.md
defines each measure. The tick of cycle k is `run.start_time_ns + k x cycle_wall_ns`. Arming rounds
do not count.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from agents.agent import Stage
from agents.cycle import STAGES, kind_of, stage_of
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Run, parse_missing
from bus_schemas.signals import COMMAND, PRODUCTION, RUN, Port
from bus_schemas.tree import PLANT, ROOT
from recordings.read.gaps import MissedInputs
from recordings.read.reader import RunReader


@dataclass(frozen=True, slots=True, eq=False)
class MessageTimes:
    """The times of the messages of a run, up to the last cycle that the plant ended.

    `ready_ns` and `publish_ns` have a row for each cycle and a column for each port: the times that
    the messages state, from the scheduled tick of their cycle; NaN: no message, or no time in it.
    `missing` has a row for each input older than due that they state: cycle and port (its number)
    of the message and the input, and the cycle of what was used `instead`, -1 for nothing. `missed`
    is how many inputs each agent missed; `fastest_ns` is the shortest time from publishing to the
    recorder.
    """

    plan: RunPlan
    ports: Sequence[Port[Message]]
    ready_ns: pd.DataFrame
    publish_ns: pd.DataFrame
    missing: pd.DataFrame
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
    cycles, numbers, readies, publishes = (array("q") for _ in range(4))
    fastest_ns: dict[Port[Message], int] = {}
    missing: dict[tuple[int, int], tuple[str, ...]] = {}
    missed = MissedInputs(plan)
    for record in reader.records(columns, range(_end_cycle(reader))):
        port, cycle = record.port, record.cycle
        message = record.message()
        missed.count(port, message)
        # A device without this host's clock states 0, one with another clock an impossible time.
        earliest_ns = max(start_ns + (cycle - 1) * plan.timing.cycle_wall_ns, 1)
        if record.publish_time_ns > record.log_time_ns or message.publish_time_ns < earliest_ns:
            continue
        travel_ns = record.log_time_ns - record.publish_time_ns
        fastest_ns[port] = min(fastest_ns.get(port, travel_ns), travel_ns)
        cycles.append(cycle)
        numbers.append(columns[port])
        readies.append(message.ready_time_ns)
        publishes.append(message.publish_time_ns)
        if message.missing:
            missing.setdefault((cycle, columns[port]), message.missing)
    times = {"cycle": cycles, "port": numbers, "ready_ns": readies, "publish_ns": publishes}
    # The first of two copies of a message is kept.
    frame = pd.DataFrame(times, dtype=np.int64).drop_duplicates(["cycle", "port"])
    ended = frame.cycle[frame.port == columns[PRODUCTION.of(ROOT)]]
    length = int(ended.max()) + 1 if len(ended) else 0
    frame = frame.set_index(["cycle", "port"])
    tick_ns = start_ns + frame.index.get_level_values("cycle") * plan.timing.cycle_wall_ns

    def table(time_ns: pd.Series) -> pd.DataFrame:
        """Lay times out by cycle and port, from the tick of their cycle."""
        shown = (time_ns - tick_ns).where(time_ns > 0).unstack().reindex(range(length))
        return shown.reindex(columns=range(len(ports))).set_axis(ports, axis=1).rename_axis(None)

    return MessageTimes(
        plan,
        ports,
        table(frame.ready_ns),
        table(frame.publish_ns),
        _missing({str(port): number for port, number in columns.items()}, missing),
        missed,
        fastest_ns,
    )


def _missing(
    numbers: Mapping[str, int], stated: Mapping[tuple[int, int], tuple[str, ...]]
) -> pd.DataFrame:
    """Return a row for each input that a message states as missing; keys of no port are ignored."""
    rows = [
        (cycle, message, numbers[key], -1 if instead is None else instead)
        for (cycle, message), entries in stated.items()
        for key, instead in map(parse_missing, entries)
        if key in numbers
    ]
    names = ["cycle", "message", "port", "instead"]
    table = pd.DataFrame(rows, columns=names, dtype=np.int64)
    return table.drop_duplicates(names[:3], keep="last")


def stage_times(messages: MessageTimes) -> list[StageTimes]:
    """Return every stage of every agent: the plant first, the stages of an agent in their order."""
    plan = messages.plan
    outputs: dict[tuple[str, str], list[int]] = {}
    for number, port in enumerate(messages.ports):
        outputs.setdefault((port.publisher, stage_of(port, plan.tree)), []).append(number)
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
    outputs: Sequence[int],
) -> StageTimes:
    """Return a stage; `pattern` is the stage in each cycle until that repeats, None: not there.

    `outputs` are the numbers of its ports.
    """
    plan = messages.plan
    name, timed = next((stage.name, stage.timed) for stage in pattern if stage is not None)
    deadline_ns = plan.deadlines.deadline_ns(agent, name)
    # The plant's tick is when its first stage begins, not when it must end.
    grace_ns = plan.deadlines.slice_ns(agent, name) if timed else 0

    closes = np.array([stage is not None for stage in pattern])
    publish_ns = messages.publish_ns.iloc[:, list(outputs)].dropna(how="all")
    publish_ns = publish_ns[closes[publish_ns.index % len(pattern)]]
    last = np.array(outputs)[np.nanargmax(publish_ns.to_numpy(), axis=1)]
    closed = pd.DataFrame({"first_ns": publish_ns.min(axis=1), "last_ns": publish_ns.max(axis=1)})
    closed["message"] = [messages.ports[number] for number in last]
    closed["ready_ns"] = _at(messages.ready_ns, closed.index, last)

    inputs = _inputs(messages, closed.assign(message=last), pattern)
    awaited = inputs[inputs.awaited]
    late, in_time = awaited[awaited.late], awaited[~awaited.late & (awaited.ns < awaited.last_ns)]
    lacking = closed.index.isin(late.cycle)
    # A stage that lacked anything waited for that; one that did not, for the last of its inputs.
    waited_for = pd.concat([late, in_time[~in_time.cycle.isin(late.cycle)]]).dropna(subset="ns")
    last_come = waited_for.sort_values("ns", ascending=False, kind="stable").drop_duplicates(
        "cycle"
    )
    causes = dict(zip(last_come.cycle, last_come.port, strict=True))
    without = late.groupby("cycle").port.agg(list)
    closed["completed_ns"] = in_time.groupby("cycle").ns.max()
    closed["oldest_ns"] = inputs.groupby("cycle").used_ns.min()
    closed["awaits"] = closed.index.isin(awaited.cycle)
    closed["lacking"] = lacking
    closed["overran"] = ~lacking & (closed.last_ns > deadline_ns + grace_ns)
    closed["without"] = [
        tuple(sorted(str(messages.ports[number]) for number in without.get(cycle, ())))
        for cycle in closed.index
    ]
    cause = [messages.ports[causes[cycle]] if cycle in causes else None for cycle in closed.index]
    closed["cause"] = pd.Series(cause, closed.index, dtype=object)
    return StageTimes(agent, name, deadline_ns, timed, closed)


def _inputs(
    messages: MessageTimes, closed: pd.DataFrame, pattern: Sequence[Stage | None]
) -> pd.DataFrame:
    """Return a row for each cycle of a stage and each of its inputs, with the number of its port.

    awaited, late: Whether the stage awaits it in this cycle, and closed without it.
    ns: When the message of this cycle went out.
    used_ns: When the message went out that the stage used, perhaps of an earlier cycle.
    """
    plan, cycle = messages.plan, closed.index.to_numpy()
    numbers = {port: number for number, port in enumerate(messages.ports)}
    stages = [stage for stage in pattern if stage is not None]
    ports = list(dict.fromkeys(port for one in stages for port in (*one.awaits, *one.uses)))
    awaits = [[stage is not None and port in stage.awaits for stage in pattern] for port in ports]
    awaited = np.array(awaits, dtype=bool).reshape(len(ports), len(pattern))
    period = np.array([plan.control.period(port) for port in ports], dtype=np.int64)[:, None]
    table = pd.DataFrame(
        {
            "cycle": np.tile(cycle, len(ports)),
            "port": np.repeat([numbers[port] for port in ports], len(cycle)).astype(np.int64),
            "awaited": awaited[:, cycle % len(pattern)].ravel(),
            "due": (cycle // period * period).ravel(),
        }
    )
    table = table.merge(closed[["last_ns", "message"]], left_on="cycle", right_index=True)
    # A stage's last message states what was missing, and the cycle of what it used instead.
    table = table.merge(messages.missing, how="left", on=["cycle", "message", "port"])
    table["late"] = table.instead.notna()
    used = table.instead.fillna(table.due).astype(np.int64)
    table["ns"] = _at(messages.publish_ns, table.cycle, table.port)
    used_ns = _at(messages.publish_ns, used, table.port)
    table["used_ns"] = used_ns + (used - table.cycle) * plan.timing.cycle_wall_ns
    return table


def _at(times_ns: pd.DataFrame, cycles: ArrayLike, ports: ArrayLike) -> NDArray[np.float64]:
    """Return the times of messages by cycle and number of their port; NaN: there is none."""
    row, values = np.asarray(cycles), times_ns.to_numpy()
    known = (row >= 0) & (row < len(values))
    return np.where(known, values[np.where(known, row, 0), np.asarray(ports)], np.nan)


def _start_ns(reader: RunReader) -> int:
    """Return when cycle 0 was to begin."""
    launched = reader.metadata["run"].get("driver") != "simulate"
    runs = (m for _, m in reader.messages(RUN) if isinstance(m, Run) and m.state == "start")
    start = next(runs, None) if launched and not reader.plan.timing.lockstep else None
    if start is None:
        raise InputError(
            f"{reader.path}: it does not say when cycle 0 began in real time, expected the "
            "recording of a run of `heliarch launch` or `timing` at a finite pace"
        )
    # Agents, too, ignore a start time that is far from now.
    is_usable = reader.plan.timing.is_on_clock(start.start_time_ns, start.publish_time_ns)
    return start.start_time_ns if is_usable else start.publish_time_ns


def _end_cycle(reader: RunReader) -> int:
    """Return the first cycle that does not count.

    An external plant goes on after Ctrl-C, when the controllers have left it.
    """
    plan = reader.plan
    if PLANT not in plan.access.external:
        return plan.timing.cycles
    own = [COMMAND.of(leaf) for leaf in plan.tree.leaves if leaf not in plan.access.external]
    last = {record.port: record.cycle for record in reader.records(own)}
    return min(last.values(), default=plan.timing.cycles - 1) + 1
