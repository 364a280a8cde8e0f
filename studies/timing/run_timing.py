"""How a run in real time kept its time, computed from its recording in one walk.

docs/timing.md defines each measure. All follow from two times that every message states: when its
stage could close (`ready_time_ns`) and when it went out (`publish_time_ns`). Durations are taken
against scheduled times: the tick of cycle k is `run.start_time_ns + k x cycle_wall_ns`. Arming
rounds do not count.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heappush, heappushpop
from typing import Final, NamedTuple

import msgspec

from agents.cycle import STAGES, kind_of, stage_place
from agents.plan import START_WITHIN_NS, RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Run
from bus_schemas.signals import COMMAND, PRODUCTION, RUN, SIGNALS, Port
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from recordings.read.reader import RecordedMessage, RunReader
from studies.timing.cycle_waits import (
    Closing,
    CycleHeads,
    CycleWaits,
    Head,
    StageTable,
    cycle_waits,
)
from studies.timing.durations import Distribution, Durations

LOOP: Final = "loop"
WHOLE_LOOP: Final = "all commands"
EVERY_COMMAND: Final = "each command"

MEASURES: Final = (LOOP, "decision", "hop", "lateness", "jitter", "age", "response")
"""What is measured, in the order in which it is reported."""

SLOWEST: Final = 3
"""How many of the slowest cycles are looked into."""

_HELD_S: Final = 3.0
"""How much later than the newest cycle a message may be recorded and still count [s]."""

_decode_head = msgspec.msgpack.Decoder(Head).decode


class Times(msgspec.Struct, frozen=True):
    """A row of durations.

    Attributes
    ----------
    measure
        One of `MEASURES`.
    of
        What was measured: a stage of a tier (`direct estimate`), a signal (`residual`).
    kind
        The kind of the agents, or the signal: names its budget if `of` does not.
    outside
        Whether they are of a device whose own times are not used.
    """

    measure: str
    of: str
    kind: str
    times: Distribution
    outside: bool = False


@dataclass(slots=True)
class AgentTiming:
    """Counts of one of our own agents.

    Attributes
    ----------
    missed_deadlines, overruns
        By stage.
    missing_inputs
        By port.
    times
        Its own rows of durations; empty unless they were asked for.
    """

    missed_deadlines: Counter[str] = field(default_factory=Counter)
    missing_inputs: Counter[str] = field(default_factory=Counter)
    overruns: Counter[str] = field(default_factory=Counter)
    old_inputs: int = 0
    skipped_cycles: int = 0
    slowest_decision_ns: int = 0
    times: tuple[Times, ...] = ()


class RunTiming(NamedTuple):
    """The timing of a run.

    Attributes
    ----------
    times
        Durations by tier and stage, and by signal.
    slowest
        The slowest cycles, the slowest first.
    loop_cycles, loop_ns
        The cycles that the plant ended, and the loop time of each.
    """

    times: tuple[Times, ...]
    agents: dict[str, AgentTiming]
    slowest: tuple[CycleWaits, ...]
    loop_cycles: array[int]
    loop_ns: array[int]

    @property
    def cycles(self) -> int:
        """How many cycles the plant ended."""
        return len(self.loop_cycles)


def tier_of(agent: str, tree: ControlTree) -> str:
    """Return an agent's kind; supervisors of several tiers have a number, 1 below the centre."""
    kind = kind_of(agent, tree)
    several = len({depth(path) for path in tree.parents if path}) > 1
    return f"{kind} {depth(agent)}" if kind == "supervisor" and several else kind


def run_timing(reader: RunReader, *, by_agent: bool = False) -> RunTiming:
    """Work out the timing of a run; with `by_agent` each agent has rows of its own too.

    Raises
    ------
    InputError
        The run was not in real time, or its recording is damaged.
    """
    ticks = _Ticks(reader)
    walk = _Walk(reader.plan, ticks, by_agent)
    for cycle, heads in _cycles(reader, ticks):
        walk.see(cycle, heads)
    return walk.timing()


class _Ticks:
    """When the cycles of a run were to begin."""

    def __init__(self, reader: RunReader) -> None:
        plan = reader.plan
        launched = reader.metadata["run"].get("driver") != "simulate"
        starts = (m for _, m in reader.messages(RUN) if isinstance(m, Run) and m.state == "start")
        start = next(starts, None) if launched and not plan.lockstep else None
        if start is None:
            raise InputError(
                f"{reader.path}: it does not say when cycle 0 began in real time, expected the "
                "recording of a run of `heliarch launch` or `timing` at a finite pace"
            )
        # Agents, too, ignore a start time that is far from now.
        is_far = abs(start.start_time_ns - start.publish_time_ns) > START_WITHIN_NS
        self._start_ns = start.publish_time_ns if is_far else start.start_time_ns
        self.cycle_ns = plan.cycle_wall_ns

    def of(self, cycle: int) -> int:
        return self._start_ns + cycle * self.cycle_ns


def _cycles(reader: RunReader, ticks: _Ticks) -> Iterator[tuple[int, CycleHeads]]:
    """Yield the messages of each cycle up to the last one that the plant ended."""
    held: dict[int, CycleHeads] = defaultdict(dict)
    hold = max(round(_HELD_S * 1e9) // ticks.cycle_ns, reader.plan.hold_cycles) + 2
    production, following, newest = PRODUCTION.of(ROOT), 0, 0
    for record in reader.records(_timed_ports(reader), range(_end_cycle(reader))):
        if record.cycle < following:
            continue
        head = _head_of(record, reader)
        # A device without this host's clock states 0, one with another clock an impossible time.
        in_past = record.publish_time_ns <= record.log_time_ns
        if in_past and head.publish_time_ns >= max(ticks.of(head.cycle - 1), 1):
            held[record.cycle].setdefault(record.port, head)
            newest = max(newest, record.cycle)
        while following + hold < newest:
            yield following, held.pop(following, {})
            following += 1
    ended = [cycle for cycle, heads in held.items() if production in heads]
    for cycle in range(following, max(ended, default=-1) + 1):
        yield cycle, held.pop(cycle, {})


def _timed_ports(reader: RunReader) -> list[Port[Message]]:
    return [port for port in reader.ports() if port.signal.is_cyclic]


def _head_of(record: RecordedMessage, reader: RunReader) -> Head:
    try:
        return _decode_head(record.payload)
    except msgspec.DecodeError as error:
        raise InputError(
            f"{reader.path}: {record.port}: {error}, expected a {record.port.signal.type.__name__}"
        ) from None


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


class _Walk:
    """Adds up cycle after cycle."""

    def __init__(self, plan: RunPlan, ticks: _Ticks, by_agent: bool) -> None:
        self._plan = plan
        self._ticks = ticks
        self._table = StageTable(plan)
        self._kind = {agent: kind_of(agent, plan.tree) for agent in self._table.agents}
        self._tier = {agent: tier_of(agent, plan.tree) for agent in self._table.agents}
        self._agents = {
            agent: AgentTiming() for agent in self._table.agents if agent not in plan.external
        }
        self._rows: dict[tuple[str, str], Durations] = defaultdict(Durations)
        self._kinds: dict[tuple[str, str], str] = {}
        self._own: dict[str, dict[tuple[str, str], Durations]] | None = (
            defaultdict(lambda: defaultdict(Durations)) if by_agent else None
        )
        self._published: dict[Port[Message], deque[tuple[int, int]]] = defaultdict(
            lambda: deque(maxlen=plan.hold_cycles + 2)
        )
        self._periods = {port: plan.period(port) for port in plan.keys.ports}
        self._deadline_ns = {
            (agent, stage): (
                plan.deadlines.deadline_ns(agent, stage),
                plan.deadlines.slice_ns(agent, stage) if stage == "sense" else 0,
            )
            for agent, kind in self._kind.items()
            for stage in STAGES[kind]
        }
        self._last: dict[tuple[str, str], tuple[int, int]] = {}
        self._spoke_ns: dict[str, int] = {}
        self._slowest: list[tuple[int, int, CycleHeads]] = []
        self._loop_cycles = array("q")
        self._loop_ns = array("q")

    def see(self, cycle: int, heads: CycleHeads) -> None:
        """Add a cycle. Cycles come in order, including those without messages."""
        tick_ns = self._ticks.of(cycle)
        for port, head in heads.items():
            self._published[port].append((cycle, head.publish_time_ns))
        closings = self._table.closings(cycle, heads)
        for agent, found in self._agents.items():
            found.skipped_cycles += agent not in closings
        for stages in closings.values():
            for closing in stages.values():
                self._see_closing(cycle, tick_ns, closing, heads)
        self._see_loop(cycle, tick_ns, heads)

    def _see_loop(self, cycle: int, tick_ns: int, heads: CycleHeads) -> None:
        for port, head in heads.items():
            if port.signal is COMMAND:
                time_ns = head.publish_time_ns - tick_ns
                self._add(LOOP, EVERY_COMMAND, "", time_ns, PLANT, port.node)
        production = heads.get(PRODUCTION.of(ROOT))
        if production is None:
            return
        outside = PLANT in self._plan.external
        applied_ns = production.publish_time_ns if outside else production.ready_time_ns
        self._add(LOOP, WHOLE_LOOP, "", applied_ns - tick_ns, PLANT, "")
        self._loop_cycles.append(cycle)
        self._loop_ns.append(applied_ns - tick_ns)
        # Of two that took as long the earlier one: `-cycle` keeps it.
        entry = production.publish_time_ns - tick_ns, -cycle, heads
        if len(self._slowest) < SLOWEST:
            heappush(self._slowest, entry)
        else:
            heappushpop(self._slowest, entry)

    def _see_closing(self, cycle: int, tick_ns: int, closing: Closing, heads: CycleHeads) -> None:
        agent, stage = closing.agent, closing.stage.name
        self._see_jitter(cycle, closing)
        if agent in self._plan.external:
            began = closing.completed_by(heads)
            began_ns = heads[began].publish_time_ns if began is not None else tick_ns
            if began is not None or closing.stage.timed:
                row, kind = f"{agent} {stage}", self._kind[agent]
                self._add("response", row, kind, closing.last_ns - began_ns, agent, stage)
            return
        found = self._agents[agent]
        decision_ns = closing.last_ns - closing.ready_ns
        found.old_inputs += sum(used is not None for used in closing.missing.values())
        found.slowest_decision_ns = max(found.slowest_decision_ns, decision_ns)
        self._add_stage("decision", closing, decision_ns)
        self._see_deadline(tick_ns, closing, found)
        self._see_age(cycle, closing, heads)
        self._see_hop(closing, heads)

    def _see_jitter(self, cycle: int, closing: Closing) -> None:
        place = closing.agent, closing.stage.name
        if place in self._last:
            last_cycle, last_ns = self._last[place]
            expected_ns = (cycle - last_cycle) * self._ticks.cycle_ns
            self._add_stage("jitter", closing, abs(closing.first_ns - last_ns - expected_ns))
        self._last[place] = cycle, closing.first_ns

    def _see_deadline(self, tick_ns: int, closing: Closing, found: AgentTiming) -> None:
        stage, without = closing.stage, closing.without
        after_ns, grace_ns = self._deadline_ns[closing.agent, stage.name]
        deadline_ns = tick_ns + after_ns
        if without or stage.timed:
            self._add_stage("lateness", closing, closing.first_ns - deadline_ns)
        if without:
            keys = [str(port) for port in without]
            found.missed_deadlines[stage.name] += 1
            found.missing_inputs.update(keys)
            return
        if closing.last_ns > deadline_ns + grace_ns:
            found.overruns[stage.name] += 1

    def _see_age(self, cycle: int, closing: Closing, heads: CycleHeads) -> None:
        used_ns = [
            time_ns
            for port in (*closing.stage.awaits, *closing.stage.uses)
            if (time_ns := self._used_ns(cycle, port, closing, heads)) is not None
        ]
        if used_ns:
            self._add_stage("age", closing, closing.ready_ns - min(used_ns))

    def _used_ns(
        self, cycle: int, port: Port[Message], closing: Closing, heads: CycleHeads
    ) -> int | None:
        """Return when the message of a port that a stage used was published; None: it used none."""
        used: int | None = cycle - cycle % self._periods[port]
        if closing.missing:
            used = closing.missing.get(str(port), used)
        if used == cycle and port in heads:
            return heads[port].publish_time_ns
        published = self._published[port]
        return next((time_ns for known, time_ns in published if known == used), None)

    def _see_hop(self, closing: Closing, heads: CycleHeads) -> None:
        """Record the hop of the input that completed a stage, if the agent was waiting for it."""
        agent, before_ns = closing.agent, self._spoke_ns.get(closing.agent, 0)
        self._spoke_ns[agent] = closing.last_ns
        port = None if closing.without else closing.completed_by(heads)
        if port is None or closing.ready_ns < before_ns:
            return
        signal, hop_ns = port.signal.name, closing.ready_ns - heads[port].publish_time_ns
        self._add("hop", signal, signal, hop_ns, agent, str(port))
        if port.publisher in self._plan.external and port.publisher != PLANT:
            self._rows["hop", f"{signal} of {port.publisher}"].add(hop_ns)
            self._kinds["hop", f"{signal} of {port.publisher}"] = signal

    def _add_stage(self, measure: str, closing: Closing, duration_ns: int) -> None:
        agent, stage = closing.agent, closing.stage.name
        row = f"{self._tier[agent]} {stage}"
        self._add(measure, row, self._kind[agent], duration_ns, agent, stage)

    def _add(
        self, measure: str, row: str, kind: str, duration_ns: int, agent: str, own_row: str
    ) -> None:
        self._rows[measure, row].add(duration_ns)
        self._kinds[measure, row] = kind
        if self._own is not None:
            self._own[agent][measure, own_row].add(duration_ns)

    def timing(self) -> RunTiming:
        """Return the timing of all cycles so far."""
        outside = {LOOP} if PLANT in self._plan.external else set()
        times = [
            Times(measure, of, self._kinds[measure, of], found, measure in {"response", *outside})
            for (measure, of), durations in self._rows.items()
            if (found := durations.distribution()) is not None
        ]
        for agent, rows in (self._own or {}).items():
            if agent in self._agents:
                self._agents[agent].times = self._own_times(agent, rows)
        slowest = tuple(
            cycle_waits(self._table, -cycle, self._ticks.of(-cycle), heads)
            for _, cycle, heads in sorted(self._slowest, key=lambda entry: entry[:2], reverse=True)
        )
        in_order = tuple(sorted(times, key=self._order))
        return RunTiming(in_order, self._agents, slowest, self._loop_cycles, self._loop_ns)

    def _own_times(self, agent: str, rows: dict[tuple[str, str], Durations]) -> tuple[Times, ...]:
        found = (
            (measure, of, durations.distribution())
            for (measure, of), durations in sorted(
                rows.items(), key=lambda row: (MEASURES.index(row[0][0]), row[0][1])
            )
        )
        return tuple(
            Times(measure, of, self._kind[agent], times)
            for measure, of, times in found
            if times is not None
        )

    def _order(self, row: Times) -> tuple[int, int, str]:
        """Sort rows by measure, then in the order of a cycle or of the table of signals."""
        place = 0
        if row.measure == LOOP:
            place = int(row.of != WHOLE_LOOP)
        elif row.measure == "hop":
            place = [signal.name for signal in SIGNALS].index(row.kind)
        else:
            name, _, stage = row.of.rpartition(" ")
            agent = next((a for a, t in self._tier.items() if name in {a, t}), PLANT)
            place = stage_place(agent, stage, self._plan.tree)
        return MEASURES.index(row.measure), place, row.of
