"""The tidy table of a run in real time: a row for each stage of each agent in each cycle.

Every message states when its stage could close (`ready_time_ns`) and when it went out
(`publish_time_ns`), and the recorder notes when it arrived. A device is measured from outside: what
counts is when its messages arrived there. docs/timing.md defines each column.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from agents.cycle import STAGES, kind_of, stage_of, stage_place
from agents.plan import RunPlan
from agents.process.machine_watch import MachineStop
from agents.team import stages_of_agents
from bus_schemas.errors import InputError
from bus_schemas.messages import Run, parse_missing
from bus_schemas.signals import COMMAND, PRODUCTION, RUN
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader

STOPS_NAME: Final = "machine_stops.json"
"""In a run's folder: when the machine stood still. Only timed runs have this file."""

SILENT, WITHOUT, OVERRUN, LATE = "silent", "without", "overrun", "late"
"""Values of `late`: published nothing in the cycle; closed without an input that it awaited; had
all inputs and published after its deadline; and of a device, came too late for a listener."""

_BLOCK_MESSAGES: Final = 150_000
"""A recording is read in blocks of cycles with about this many messages."""

_COLUMNS: Final = [
    *("cycle", "agent", "tier", "stage", "first", "ready", "published", "arrived"),
    *(
        "tick",
        "deadline",
        "awaited",
        "awaited_sent",
        "awaited_arrived",
        "oldest",
        "without",
        "late",
    ),
    *("device", "across", "timed", "order"),
]


def tier_of(agent: str, tree: ControlTree) -> str:
    """Return an agent's kind; supervisors of several tiers have a number, 1 below the centre."""
    kind = kind_of(agent, tree)
    several = len({depth(path) for path in tree.parents if path}) > 1
    return f"{kind} {depth(agent)}" if kind == "supervisor" and several else kind


def stage_table(reader: RunReader, stops: Sequence[MachineStop] | None = None) -> pd.DataFrame:
    """Return the tidy table of a run, up to the last cycle that the plant ended.

    All times but `tick` are in ms after the cycle's scheduled tick. `stops` are the times in which
    the machine stood still; None: they are read from the run's folder.
    """
    graph, start_ns, end = _Graph(reader.plan), start_ns_of(reader), _end_cycle(reader)
    history = reader.plan.control.periods.longest + reader.plan.control.hold_cycles
    length = max(_BLOCK_MESSAGES // len(graph.ports), 1)
    parts = []
    for begin in range(0, end, length):
        # A message can be used for several cycles, so each block begins with those before it.
        cycles = range(max(begin - history, 0), min(begin + length, end))
        messages, missing = _read(reader, graph, cycles, start_ns)
        rows = _rows(graph, cycles, messages, missing)
        parts.append(rows[rows.cycle >= begin])
    if not parts:
        raise InputError(f"{reader.path}: expected a complete cycle, got none")
    table = pd.concat(parts, ignore_index=True)
    stops = stops_of(reader.path.parent) if stops is None else stops
    stopped = _stopped_ms(stops or (), start_ns, reader.plan.timing.cycle_wall_ns)
    return table.assign(stopped=table.cycle.map(stopped).fillna(np.nan if stops is None else 0.0))


def stops_of(folder: Path) -> list[MachineStop] | None:
    """Return when the machine stood still in a timed run; None: nobody watched."""
    path = folder / STOPS_NAME
    return msgspec.json.decode(path.read_bytes(), type=list[MachineStop]) if path.exists() else None


def sender_of(plan: RunPlan) -> dict[str, tuple[str, str]]:
    """Return agent and stage by the key on which they publish regularly."""
    return {
        str(port): (port.publisher, stage_of(port, plan.tree))
        for port in plan.wiring.ports
        if port.signal.logged and due_step(plan, port)
    }


class _Graph:
    """The ports and stages of a run, by their numbers.

    ports: Columns agent (the publisher), stage (its number), period (in cycles), device.
    stages: Columns agent, tier, stage, order, device, deadline, grace (how much later it may
        publish) [ms], timed (whether the clock begins it).
    inputs: A row for each input of a stage in each turn: stage, turn, input (number of the port),
        awaited. Turns are cycles until they repeat.
    closes: Whether a stage closes in a turn, shape (turns, stages).
    """

    def __init__(self, plan: RunPlan) -> None:
        self.plan = plan
        tree, deadlines, devices = plan.tree, plan.deadlines, plan.access.external
        self.keys = [
            port for port in plan.wiring.ports if port.signal.is_cyclic and port.signal.logged
        ]
        self.number = {port: at for at, port in enumerate(self.keys)}
        turns = stages_of_agents(plan)
        names = [(agent, name) for agent in turns for name in STAGES[kind_of(agent, tree)]]
        places = {name: at for at, name in enumerate(names)}
        self.ports = pd.DataFrame(
            {
                "stage": [places[port.publisher, stage_of(port, tree)] for port in self.keys],
                "period": [plan.control.period(port) for port in self.keys],
                "device": [port.publisher in devices for port in self.keys],
            }
        )
        self.closes = np.zeros((plan.control.periods.longest, len(names)), dtype=bool)
        stages, inputs = [], []
        for row, (agent, name) in enumerate(names):
            is_timed = False
            for turn, several in enumerate(turns[agent]):
                for stage in (one for one in several if one.name == name):
                    self.closes[turn, row], is_timed = True, stage.timed
                    for port in dict.fromkeys((*stage.awaits, *stage.uses)):
                        inputs.append((row, turn, self.number[port], port in stage.awaits))
            grace_ns = deadlines.slice_ns(agent, name) if is_timed else 0
            limits_ms = (deadlines.deadline_ns(agent, name) / 1e6, grace_ns / 1e6)
            order, tier = stage_place(agent, name, tree), tier_of(agent, tree)
            stages.append((agent, tier, name, order, agent in devices, *limits_ms, is_timed))
        columns = ["agent", "tier", "stage", "order", "device", "deadline", "grace", "timed"]
        self.stages = pd.DataFrame(stages, columns=columns)
        self.inputs = pd.DataFrame(inputs, columns=["stage", "turn", "input", "awaited"])


def _read(
    reader: RunReader, graph: _Graph, cycles: range, start_ns: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Read the messages of some cycles, and what they state as missing.

    The first table has a row for each message: cycle, port, and ready, published, arrived, sent
    [ms after its cycle's tick]; `sent` is when a device's message arrived, since its clock is not
    trusted. The second has one for each input older than due: cycle, message and input (numbers of
    ports), and the cycle of what was used `instead`, -1 for nothing.
    """
    keys = {str(port): number for port, number in graph.number.items()}
    devices = {port for port in graph.number if port.publisher in graph.plan.access.external}
    columns = tuple(array("q") for _ in range(5))
    missing: list[tuple[int, int, int, int]] = []
    offset_ns = 0  # From the monotonic clock to that of the recording.
    for record in reader.records(graph.number, cycles):
        message = record.message()
        if record.port not in devices:
            offset_ns = record.publish_time_ns - message.publish_time_ns
        port, arrived_ns = graph.number[record.port], record.log_time_ns - offset_ns
        times_ns = message.ready_time_ns, message.publish_time_ns, arrived_ns
        for column, value in zip(columns, (record.cycle, port, *times_ns), strict=True):
            column.append(value)
        for key, instead in map(parse_missing, message.missing):
            if key in keys:
                used = -1 if instead is None else instead
                missing.append((record.cycle, port, keys[key], used))
    names = ["cycle", "port", "ready", "published", "arrived"]
    frame = pd.DataFrame({name: np.array(one) for name, one in zip(names, columns, strict=True)})
    # The first of two copies of a message is kept.
    frame = frame.drop_duplicates(["cycle", "port"], ignore_index=True)
    tick_ns = start_ns + frame.cycle * graph.plan.timing.cycle_wall_ns
    for name in names[2:]:
        frame[name] = ((frame[name] - tick_ns) / 1e6).where(frame[name] > 0)
    is_device = graph.ports.device.to_numpy()[frame.port]
    frame["sent"] = frame.arrived.where(is_device, frame.published)
    stated = pd.DataFrame(missing, columns=["cycle", "message", "input", "instead"], dtype=np.int64)
    return frame, stated.drop_duplicates(["cycle", "message", "input"], keep="last")


def _rows(
    graph: _Graph, cycles: range, messages: pd.DataFrame, missing: pd.DataFrame
) -> pd.DataFrame:
    """Return the rows of some cycles: one for each stage that closes in a cycle."""
    number = np.array(cycles)
    at, stage = np.nonzero(graph.closes[number % len(graph.closes)])
    rows = pd.DataFrame({"cycle": number[at], "stage": stage})
    rows = rows.join(_published(graph, messages), on=["cycle", "stage"])
    inputs = _inputs(graph, rows, messages, missing, cycles)
    for name, values in _of_inputs(graph, inputs, rows).items():
        rows[name] = values
    of_stage = graph.stages.loc[rows.stage].set_index(rows.index)
    rows = pd.concat([rows.drop(columns=["stage", "message"]), of_stage], axis="columns")
    rows["without"] = rows.without.fillna("")
    rows["tick"] = rows.cycle * graph.plan.timing.cycle_wall_ns / 1e6
    speaks = rows.published.notna() | rows.arrived.notna()
    is_silent = ~speaks.groupby([rows.cycle, rows.agent], observed=True).transform("any")
    overran = rows.published > rows.deadline + rows.grace
    causes = [is_silent, rows.device & rows.unheard, rows.device, rows.without != "", overran]
    rows["late"] = np.select(causes, [SILENT, LATE, "", WITHOUT, OVERRUN], "")
    awaited, host = np.array(["", *map(str, graph.keys)]), graph.plan.access.addresses
    sender = np.array([None, *(host.get(port.publisher, "") for port in graph.keys)])
    number = rows.awaited.fillna(-1).to_numpy(dtype=int) + 1
    rows["awaited"] = pd.Categorical(awaited[number], awaited)
    rows["across"] = (number > 0) & (
        sender[number] != rows.agent.map(lambda one: host.get(one, ""))
    )
    rows["late"] = pd.Categorical(rows.late, [SILENT, WITHOUT, OVERRUN, LATE, ""])
    for name in ("agent", "tier", "stage"):
        rows[name] = pd.Categorical(rows[name], graph.stages[name].unique())
    return rows[_COLUMNS]


def _published(graph: _Graph, messages: pd.DataFrame) -> pd.DataFrame:
    """Return of each stage that published: its last message, and its times."""
    table = messages.sort_values("sent", kind="stable").rename(columns={"port": "message"})
    table["stage"] = graph.ports.stage.to_numpy()[table.message]
    by = table.groupby(["cycle", "stage"])
    last = by[["message", "ready", "published", "arrived", "sent"]].last()
    return last.assign(first=by.published.min())


def _inputs(
    graph: _Graph,
    rows: pd.DataFrame,
    messages: pd.DataFrame,
    missing: pd.DataFrame,
    cycles: range,
) -> pd.DataFrame:
    """Return a row for each input of each stage that published, `at` being the stage's row.

    instead: The cycle of an older message that it used; -1: of none; NaN: it used the one due.
    sent, arrived: Times of the message of this cycle. used: When the message went out that it used.
    """
    known = rows.dropna(subset="message").assign(turn=rows.cycle % len(graph.closes))
    table = known[["cycle", "stage", "turn", "message"]].rename_axis("at").reset_index()
    table["message"] = table.message.astype(np.int64)
    table = table.merge(graph.inputs, on=["stage", "turn"])
    table = table.merge(missing, how="left", on=["cycle", "message", "input"])
    period = graph.ports.period.to_numpy()[table.input]
    used = table.instead.fillna(table.cycle // period * period).astype(np.int64)
    shape = len(cycles), len(graph.ports)

    def time_of(column: str, of: ArrayLike) -> NDArray[np.float64]:
        times = np.full(shape, np.nan)
        times[messages.cycle - cycles.start, messages.port] = messages[column]
        row = np.asarray(of) - cycles.start
        is_known = (row >= 0) & (row < shape[0])
        return np.where(is_known, times[np.where(is_known, row, 0), table.input], np.nan)

    cycle_ms = graph.plan.timing.cycle_wall_ns / 1e6
    table["sent"], table["arrived"] = time_of("sent", table.cycle), time_of("arrived", table.cycle)
    table["used"] = time_of("sent", used) + (used - table.cycle) * cycle_ms
    return table


def _of_inputs(graph: _Graph, inputs: pd.DataFrame, rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Return the columns of stages that follow from their inputs, by the numbers of the rows."""
    awaited = inputs[inputs.awaited]
    lacking = awaited[awaited.instead.notna()]
    came = awaited[awaited.instead.isna()]
    # A stage that lacked anything waited for that; any other for the last of its inputs.
    waited = pd.concat([lacking, came[~came["at"].isin(lacking["at"])]]).dropna(subset="sent")
    last = waited.sort_values("sent", kind="stable").drop_duplicates("at", keep="last")
    last = last.set_index("at")
    keys = pd.Series(list(map(str, graph.keys)))
    texts = keys.loc[lacking.input].set_axis(lacking["at"])
    late = set(zip(lacking.cycle, graph.ports.stage.to_numpy()[lacking.input], strict=True))
    is_late = [place in late for place in zip(rows.cycle, rows.stage, strict=True)]
    return {
        "awaited": last.input,
        "awaited_sent": last.sent,
        "awaited_arrived": last.arrived,
        "oldest": inputs.groupby("at").used.min(),
        "without": texts.groupby(level=0).agg(", ".join),
        "unheard": pd.Series(is_late, rows.index),
    }


def _stopped_ms(stops: Iterable[MachineStop], start_ns: int, cycle_ns: int) -> Mapping[int, float]:
    """Return for how long the machine stood still in each cycle in which it did [ms]."""
    found: Counter[int] = Counter()
    for began_ns, ended_ns in stops:
        for cycle in range(
            (began_ns - start_ns) // cycle_ns, (ended_ns - start_ns) // cycle_ns + 1
        ):
            begin_ns = start_ns + cycle * cycle_ns
            found[cycle] += min(ended_ns, begin_ns + cycle_ns) - max(began_ns, begin_ns)
    return {cycle: stopped_ns / 1e6 for cycle, stopped_ns in found.items()}


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
