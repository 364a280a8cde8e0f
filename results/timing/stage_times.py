"""When each stage of each agent closed in each cycle, read from a recording in real time.

Every message states when its stage could close (`ready_time_ns`) and when it went out
(`publish_time_ns`). All that `heliarch timing` reports follows from these two; docs/timing.md
defines each measure. Tables here count both from the tick of cycle 0 [ns]; the tick of cycle k is
k x `cycle_wall_ns` after it. Arming rounds do not count.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from agents.cycle import STAGES, kind_of, stage_of, stage_place
from agents.plan import RunPlan
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import Run, parse_missing
from bus_schemas.signals import COMMAND, PRODUCTION, RUN
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from recordings.read.reader import RunReader

BLOCK_MESSAGES: Final = 150_000
"""A recording is read in blocks of cycles with about so many messages, to bound the memory."""


def tier_of(agent: str, tree: ControlTree) -> str:
    """Return an agent's kind; supervisors of several tiers have a number, 1 below the centre."""
    kind = kind_of(agent, tree)
    several = len({depth(path) for path in tree.parents if path}) > 1
    return f"{kind} {depth(agent)}" if kind == "supervisor" and several else kind


class RunGraph:
    """The ports and stages of a run, by their numbers.

    ports: Columns agent (the publisher), stage (its number), signal, period (in cycles).
    stages: Columns agent, name, kind, tier, order, device (whether it is one's own device),
        across (whether it awaits inputs from another host, whose clock is another), deadline_ns,
        grace_ns (how much later it may publish), timed, and row (what it is reported under).
    inputs: A row for each input of a stage in each turn: stage, turn, input (number of the port),
        awaited. Turns are cycles until they repeat.
    closes: Whether a stage closes in a turn, shape (stages, turns).
    """

    def __init__(self, plan: RunPlan) -> None:
        self.plan = plan
        tree, deadlines = plan.tree, plan.deadlines
        self.messages = [
            port for port in plan.wiring.ports if port.signal.is_cyclic and port.signal.logged
        ]
        number = {port: at for at, port in enumerate(self.messages)}
        turns = stages_of_agents(plan)
        names = [(agent, name) for agent in turns for name in STAGES[kind_of(agent, tree)]]
        stage_numbers = {name: at for at, name in enumerate(names)}
        self.ports = pd.DataFrame(
            {
                "agent": [port.publisher for port in self.messages],
                "stage": [stage_numbers[p.publisher, stage_of(p, tree)] for p in self.messages],
                "signal": [port.signal.name for port in self.messages],
                "period": [plan.control.period(port) for port in self.messages],
            }
        )
        stages, inputs = [], []
        self.closes = np.zeros((len(names), plan.control.periods.longest), dtype=bool)
        for row, (agent, name) in enumerate(names):
            for turn, several in enumerate(turns[agent]):
                for stage in (one for one in several if one.name == name):
                    self.closes[row, turn], timed = True, stage.timed
                    for port in dict.fromkeys((*stage.awaits, *stage.uses)):
                        inputs.append((row, turn, number[port], port in stage.awaits))
            deadline_ns, slice_ns = deadlines.deadline_ns(agent, name), 0
            if timed:  # The plant's tick is when its first stage begins, not when it must end.
                slice_ns = deadlines.slice_ns(agent, name)
            kind, tier = kind_of(agent, tree), tier_of(agent, tree)
            order, device = stage_place(agent, name, tree), agent in plan.access.external
            stages.append((agent, name, kind, tier, order, device, deadline_ns, slice_ns, timed))
        columns = ["agent", "name", "kind", "tier", "order", "device"]
        columns += ["deadline_ns", "grace_ns", "timed"]
        self.stages = pd.DataFrame(stages, columns=columns)
        self.stages["row"] = self.stages.tier + " " + self.stages.name
        self.inputs = pd.DataFrame(inputs, columns=["stage", "turn", "input", "awaited"])
        host = {agent: plan.access.addresses.get(agent, "") for agent in turns}
        there = self.ports.agent[self.inputs.input].map(host).to_numpy()
        here = self.stages.agent[self.inputs.stage].map(host).to_numpy()
        self.stages["across"] = self.stages.index.isin(
            self.inputs.stage[self.inputs.awaited & (there != here)]
        )


class Block(NamedTuple):
    """The messages of some cycles, and the stages that published them.

    `messages` has a row for each message: cycle, port (its number), ready_ns, publish_ns. `closed`
    has one for each cycle in which a stage published anything; NaN: there is none.

    cycle, stage, and the columns of the stage.
    first_ns, last_ns, message: When its first and last messages went out, and the last one's port.
    ready_ns: When it could close.
    completed_ns: When the last awaited input that came in time went out.
    oldest_ns: When the oldest message that it used went out, perhaps in an earlier cycle.
    cause: Port that it waited for last: the input that completed it, or that came too late.
    awaits, lacking, overran: Whether it awaits anything in this cycle; whether it closed without an
        awaited input; whether it had them all, but published after its deadline.

    `late` has a row for each awaited input that a stage closed without: cycle, stage, input.
    """

    cycles: range
    messages: pd.DataFrame
    closed: pd.DataFrame
    late: pd.DataFrame


def read_blocks(reader: RunReader, graph: RunGraph, block_messages: int) -> Iterator[Block]:
    """Yield the run block by block, up to the last cycle that the plant ended."""
    start_ns, end = start_ns_of(reader), _end_cycle(reader)
    length = max(block_messages // len(graph.ports), 1)
    before: pd.DataFrame | None = None
    for begin in range(0, end, length):
        cycles = range(begin, min(begin + length, end))
        messages, missing = _read(reader, graph, cycles, start_ns)
        known = messages if before is None else pd.concat([before, messages], ignore_index=True)
        closed = _closed(messages, graph)
        inputs = _inputs(closed, known, missing, graph)
        _add_inputs(closed, inputs)
        late = inputs.loc[inputs.awaited & inputs.late, ["cycle", "stage", "input"]]
        yield Block(cycles, messages, closed, late)
        # A message can be used for so many cycles.
        history = graph.plan.control.periods.longest + graph.plan.control.hold_cycles
        before = known[known.cycle >= cycles.stop - history]


def _read(
    reader: RunReader, graph: RunGraph, cycles: range, start_ns: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Read the messages of some cycles, and what they state as missing.

    The second table has a row for each input older than due: cycle, message and input (numbers of
    ports), and the cycle of what was used `instead`, -1 for nothing.
    """
    numbers = {port: number for number, port in enumerate(graph.messages)}
    keys = {str(port): number for port, number in numbers.items()}
    cycle_ns = graph.plan.timing.cycle_wall_ns
    columns = tuple(array("q") for _ in range(4))
    missing: list[tuple[int, int, int, int]] = []
    for record in reader.records(numbers, cycles):
        message = record.message()
        # A device without this host's clock states 0, one with another clock an impossible time.
        earliest_ns = max(start_ns + (record.cycle - 1) * cycle_ns, 1)
        if record.publish_time_ns > record.log_time_ns or message.publish_time_ns < earliest_ns:
            continue
        port, times_ns = numbers[record.port], (message.ready_time_ns, message.publish_time_ns)
        for column, value in zip(columns, (record.cycle, port, *times_ns), strict=True):
            column.append(value)
        for key, instead in map(parse_missing, message.missing):
            if key in keys:
                used = -1 if instead is None else instead
                missing.append((record.cycle, port, keys[key], used))
    names = ["cycle", "port", "ready_ns", "publish_ns"]
    frame = pd.DataFrame({name: np.array(one) for name, one in zip(names, columns, strict=True)})
    # The first of two copies of a message is kept.
    frame = frame.drop_duplicates(["cycle", "port"], ignore_index=True)
    frame["ready_ns"] = (frame.ready_ns - start_ns).where(frame.ready_ns > 0)
    frame["publish_ns"] = (frame.publish_ns - start_ns).astype(float)
    stated = pd.DataFrame(missing, columns=["cycle", "message", "input", "instead"], dtype=np.int64)
    return frame, stated.drop_duplicates(["cycle", "message", "input"], keep="last")


def _closed(messages: pd.DataFrame, graph: RunGraph) -> pd.DataFrame:
    """Return the stages that published, with what follows from their own messages alone."""
    table = messages.sort_values("publish_ns", kind="stable").rename(columns={"port": "message"})
    table["stage"] = graph.ports.stage.to_numpy()[table.message]
    table["turn"] = table.cycle % graph.closes.shape[1]
    table = table[graph.closes[table.stage, table.turn]]
    table["first_ns"] = table.groupby(["cycle", "stage"]).publish_ns.transform("min")
    closed = table.drop_duplicates(["cycle", "stage"], keep="last", ignore_index=True)
    closed = closed.rename(columns={"publish_ns": "last_ns"})
    return closed.join(graph.stages, on="stage").assign(
        tick_ns=closed.cycle * graph.plan.timing.cycle_wall_ns
    )


def _inputs(
    closed: pd.DataFrame, known: pd.DataFrame, missing: pd.DataFrame, graph: RunGraph
) -> pd.DataFrame:
    """Return a row for each input of each closed stage, `at` being the stage's row.

    late: Whether the stage's last message states that it had not come.
    came_ns: When the message of this cycle went out.
    used_ns: When the message went out that the stage used, perhaps of an earlier cycle.
    """
    own = closed[["cycle", "stage", "turn", "message", "last_ns"]].rename_axis("at")
    table = own.reset_index().merge(graph.inputs, on=["stage", "turn"])
    table = table.merge(missing, how="left", on=["cycle", "message", "input"])
    period = graph.ports.period.to_numpy()[table.input]
    table["late"] = table.instead.notna()
    used = table.instead.fillna(table.cycle // period * period).astype(np.int64)
    first = int(known.cycle.min()) if len(known) else 0
    sent_ns = np.full(
        (int(known.cycle.max() if len(known) else 0) - first + 1, len(graph.ports)), np.nan
    )
    sent_ns[known.cycle - first, known.port] = known.publish_ns

    def sent(cycles: ArrayLike) -> NDArray[np.float64]:
        row = np.asarray(cycles) - first
        there = (row >= 0) & (row < len(sent_ns))
        return np.where(there, sent_ns[np.where(there, row, 0), table.input], np.nan)

    table["came_ns"], table["used_ns"] = sent(table.cycle), sent(used)
    return table


def _add_inputs(closed: pd.DataFrame, inputs: pd.DataFrame) -> None:
    """Add to closed stages what follows from their inputs."""
    awaited = inputs[inputs.awaited]
    late = awaited[awaited.late]
    in_time = awaited[~awaited.late & (awaited.came_ns < awaited.last_ns)]
    closed["awaits"] = closed.index.isin(awaited["at"])
    closed["lacking"] = closed.index.isin(late["at"])
    closed["overran"] = ~closed.lacking & (
        closed.last_ns > closed.tick_ns + closed.deadline_ns + closed.grace_ns
    )
    closed["completed_ns"] = in_time.groupby("at").came_ns.max()
    closed["oldest_ns"] = inputs.groupby("at").used_ns.min()
    # A stage that lacked anything waited for that; one that did not, for the last of its inputs.
    waited_for = pd.concat([late, in_time[~in_time["at"].isin(late["at"])]]).dropna(
        subset="came_ns"
    )
    last = waited_for.sort_values("came_ns", kind="stable").drop_duplicates("at", keep="last")
    closed["cause"] = last.set_index("at").input


def start_ns_of(reader: RunReader) -> int:
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
    """Return the first cycle that does not count: the plant did not end it.

    An external plant goes on after Ctrl-C, when the controllers have left it.
    """
    plan, end = reader.plan, reader.plan.timing.cycles
    if PLANT in plan.access.external:
        own = [COMMAND.of(leaf) for leaf in plan.tree.leaves if leaf not in plan.access.external]
        last = [reader.last_cycle_on([port]) for port in own]
        end = min((cycle for cycle in last if cycle >= 0), default=end - 1) + 1
    return min(reader.last_cycle_on([PRODUCTION.of(ROOT)]) + 1, end)
