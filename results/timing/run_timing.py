"""What a run in real time measured: rows of durations, and counts of each process.

docs/timing.md defines each measure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from agents.process.machine_watch import MachineStop
from bus_schemas.signals import COMMAND, PRODUCTION, SIGNALS
from bus_schemas.tree import PLANT
from recordings.read.reader import RunReader
from results.timing.cycle_waits import CycleWaits, cycle_waits
from results.timing.stage_times import BLOCK_MESSAGES, Block, RunGraph, read_blocks, start_ns_of

WHOLE_LOOP: Final = "all commands"
_EVERY_COMMAND: Final = "each command"

MEASURES: Final = ("loop", "decision", "hop", "lateness", "age", "response")
"""What is measured, in the order in which it is reported."""

SLOWEST: Final = 3
"""How many of the slowest cycles are looked into."""

COUNTS: Final = ["missed_deadlines", "missing_inputs", "overruns", "skipped_cycles"]
"""What is counted of each process."""

_SHARES: Final = {"min_us": 0.0, "p50_us": 0.5, "p99_us": 0.99, "p99_9_us": 0.999, "max_us": 1.0}


class RunTiming(NamedTuple):
    """The timing of a run.

    durations: How often each duration occurred: measure, of, us (whole microseconds), count.
    processes: Of each of Heliarch's agents: agent, and its counts missed_deadlines,
        missing_inputs, overruns, skipped_cycles.
    slowest: The slowest cycles, the slowest first.
    late_cycles: How many cycles one of those agents missed a deadline in, overran or published
        nothing.
    late_stopped: In how many of them the machine stood still.
    loop_ms: How long the loop took, by cycle; only those that the plant ended.
    """

    durations: pd.DataFrame
    processes: pd.DataFrame
    slowest: tuple[CycleWaits, ...]
    late_cycles: int
    late_stopped: int
    loop_ms: pd.Series


def run_timing(
    reader: RunReader, stops: Sequence[MachineStop] = (), *, block_messages: int = BLOCK_MESSAGES
) -> RunTiming:
    """Work out the timing of a run, in memory that does not grow with its length.

    `stops` are the times in which the machine stood still.
    """
    graph = RunGraph(reader.plan)
    production = graph.messages.index(PRODUCTION.of(""))
    loop_from = "publish_ns" if PLANT in graph.plan.access.external else "ready_ns"
    names = pd.Index(row_names(graph))
    durations = pd.DataFrame(columns=["measure", "of", "us", "count"], dtype=np.int64)
    agents = pd.Index(graph.stages.agent[~graph.stages.device].unique(), name="agent")
    processes = pd.DataFrame(0, index=agents, columns=COUNTS)
    slowest: list[CycleWaits] = []
    loops_ms, late = [pd.Series(dtype=float)], [pd.Index([], dtype=np.int64)]
    before: pd.DataFrame | None = None
    for block in read_blocks(reader, graph, block_messages):
        ended = block.messages[block.messages.port == production].set_index("cycle")
        ended = ended.sub(ended.index * graph.plan.timing.cycle_wall_ns, axis="index") / 1e6
        loops_ms.append(ended[loop_from])
        slow = [cycle_waits(graph, block, at) for at in ended.publish_ns.nlargest(SLOWEST).index]
        slowest = sorted([*slowest, *slow], key=lambda one: -one.length_ms)[:SLOWEST]
        # Whether an agent was busy depends on what it did before the block.
        closed = pd.concat([before, block.closed]) if before is not None else block.closed
        closed = closed.sort_values(["cycle", "stage"], ignore_index=True)
        before = closed.drop_duplicates("stage", keep="last")
        loop = ("loop", WHOLE_LOOP, ended[loop_from] * 1e6)
        durations = _merged(durations, [loop, *_durations(graph, block, closed)], names)
        late.append(_count(processes, block))
    durations["measure"] = np.array(MEASURES)[durations.measure]
    durations["of"] = names[durations.of]
    stopped = _stopped_ms(stops, start_ns_of(reader), graph.plan.timing.cycle_wall_ns)
    return RunTiming(
        durations,
        processes.reset_index(),
        tuple(one._replace(stopped_ms=stopped.get(one.cycle, 0.0)) for one in slowest),
        sum(map(len, late)),
        sum(cycle in stopped for cycles in late for cycle in cycles),
        pd.concat(loops_ms),
    )


def _stopped_ms(stops: Sequence[MachineStop], start_ns: int, cycle_ns: int) -> dict[int, float]:
    """Return for how long the machine stood still in each cycle in which it did [ms]."""
    stopped_ms: dict[int, float] = {}
    for began_ns, ended_ns in stops:
        first, last = ((at_ns - start_ns) // cycle_ns for at_ns in (began_ns, ended_ns))
        for cycle in range(first, last + 1):
            begin_ns = start_ns + cycle * cycle_ns
            part_ns = min(ended_ns, begin_ns + cycle_ns) - max(began_ns, begin_ns)
            stopped_ms[cycle] = stopped_ms.get(cycle, 0.0) + part_ns / 1e6
    return stopped_ms


def row_names(graph: RunGraph) -> list[str]:
    """Return what can be measured, in the order in which it is reported."""
    stages = graph.stages.sort_values("order", kind="stable")
    signals = [one.name for one in SIGNALS]
    devices = graph.plan.access.external
    own = stages[stages.device]
    names = [WHOLE_LOOP, _EVERY_COMMAND, *stages.row.unique().tolist(), *signals]
    names += [f"{signal} of {device}" for signal in signals for device in devices]
    return list(dict.fromkeys([*names, *(own.agent + " " + own.name)]))


def _durations(
    graph: RunGraph, block: Block, closed: pd.DataFrame
) -> Iterator[tuple[str, object, pd.Series]]:
    """Yield measures, their rows (one for all or one for each), and durations; NaN: none.

    Of a device only what can be seen from outside is measured.
    """
    signal, agent = graph.ports.signal.to_numpy(), graph.ports.agent.to_numpy()
    cycle_ns = graph.plan.timing.cycle_wall_ns
    commands = block.messages[signal[block.messages.port] == COMMAND.name]
    yield "loop", _EVERY_COMMAND, commands.publish_ns - commands.cycle * cycle_ns
    # When the agent had last published before each stage.
    spoke_ns = closed.groupby("agent").last_ns.cummax().groupby(closed.agent).shift()
    is_new = closed.cycle >= block.cycles.start
    was_busy = (spoke_ns > closed.ready_ns)[is_new]
    new = closed[is_new]
    own = new[~new.device]
    yield "decision", own.row, own.last_ns - own.ready_ns
    yield "age", own.row, own.ready_ns - own.oldest_ns
    by_clock = own[own.timed | own.lacking]
    yield "lateness", by_clock.row, by_clock.first_ns - by_clock.tick_ns - by_clock.deadline_ns
    device = new[new.device]
    answered_ns = device.last_ns - device.completed_ns.fillna(device.tick_ns.where(device.timed))
    yield "response", device.agent + " " + device.name, answered_ns
    waited = own[~was_busy[own.index] & ~own.lacking & ~own.across]
    waited = waited.dropna(subset=["cause", "completed_ns"])
    cause, hop_ns = waited.cause.astype(int), waited.ready_ns - waited.completed_ns
    yield "hop", signal[cause], hop_ns
    devices = pd.Series(agent[cause], waited.index)
    devices = devices[devices.isin(set(graph.plan.access.external) - {PLANT})]
    of_devices = pd.Series(signal[cause], waited.index)[devices.index] + " of " + devices
    yield "hop", of_devices, hop_ns[devices.index]


def _merged(
    durations: pd.DataFrame, measured: Iterable[tuple[str, object, pd.Series]], names: pd.Index
) -> pd.DataFrame:
    """Add durations to those counted so far; below 0 counts as 0."""
    tables = [durations]
    for measure, of, ns in measured:
        table = pd.DataFrame({"of": of, "us": ns / 1e3}).dropna()
        table["of"] = names.get_indexer(pd.Index(table.of))
        table["us"] = table.us.clip(0).round().astype(np.int64)
        tables.append(table.assign(measure=MEASURES.index(measure), count=1))
    by = ["measure", "of", "us"]
    return pd.concat(tables).groupby(by)["count"].sum().reset_index()


def _count(processes: pd.DataFrame, block: Block) -> pd.Index:
    """Add what went wrong in the cycles of a block; return those that were late."""
    closed = block.closed[~block.closed.device]
    cycles = len(block.cycles)
    by_agent = closed.groupby("agent")
    missing = block.late.merge(closed[["cycle", "stage", "agent"]], on=["cycle", "stage"])
    counts = pd.DataFrame(
        {
            "missed_deadlines": by_agent.lacking.sum(),
            "missing_inputs": missing.groupby("agent").size(),
            "overruns": by_agent.overran.sum(),
            "skipped_cycles": cycles - by_agent.cycle.nunique(),
        },
        index=processes.index,
    )
    counts["skipped_cycles"] = counts.skipped_cycles.fillna(cycles)
    counts = counts.fillna(0).astype(int)
    processes[counts.columns] += counts
    wrong = (closed.lacking | closed.overran).groupby(closed.cycle).any()
    complete = closed.groupby("cycle").agent.nunique() == len(processes)
    return pd.Index(block.cycles).difference(wrong.index[complete & ~wrong])


def percentiles(durations: pd.DataFrame) -> pd.DataFrame:
    """Summarise the durations of each row: measure, of, count, and min, p50, p99, p99.9, max [us].

    A percentile is the least duration that so many percent do not exceed.
    """
    rows = durations.groupby(["measure", "of"], sort=False)
    reached, count = rows["count"].cumsum(), rows["count"].transform("sum")
    table = {"count": rows["count"].sum()}
    for name, share in _SHARES.items():
        enough = durations[reached >= share * count - 1e-6]
        table[name] = enough.groupby(["measure", "of"], sort=False).us.first()
    return pd.DataFrame(table).reset_index()
