"""What a run in real time measured: rows of durations, and counts of each process.

docs/timing.md defines each measure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Final, NamedTuple, TypeAlias, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.cycle import KINDS, Kind, kind_of, stage_place
from bus_schemas.signals import COMMAND, PRODUCTION, SIGNALS
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from launch_scripts.launcher.summary import ProcessAccount
from recordings.read.reader import RunReader
from studies.timing.clocks import ACROSS, ClockOffset, clock_of, clock_offsets, on_one_clock
from studies.timing.cycle_waits import CycleWaits, cycle_waits
from studies.timing.durations import Times, distribution
from studies.timing.stage_times import (
    NEVER,
    MessageTimes,
    StageTimes,
    read_message_times,
    stage_times,
)

LOOP: Final = "loop"
WHOLE_LOOP: Final = "all commands"
EVERY_COMMAND: Final = "each command"

MEASURES: Final = (LOOP, "decision", "hop", "lateness", "jitter", "age", "response")
"""What is measured, in the order in which it is reported."""

SLOWEST: Final = 3
"""How many of the slowest cycles are looked into."""

Durations: TypeAlias = NDArray[np.int64]
N = TypeVar("N", int, float)


class ProcessTiming(msgspec.Struct, frozen=True, kw_only=True):
    """Counts and resources of one process; None where only its launcher knew and is not asked.

    Deadlines and overruns are counted by stage, missing inputs by port, dropped messages by cause.
    Processor time is in % of one core.
    """

    agent: str
    tier: str
    kind: Kind
    missed_deadlines: dict[str, int] = {}
    missing_inputs: dict[str, int] = {}
    old_inputs: int = 0
    overruns: dict[str, int] = {}
    skipped_cycles: int = 0
    slowest_decision_us: float | None = None
    dropped: dict[str, int] | None = None
    cpu_percent: float | None = None
    resident_mb: float | None = None
    times: tuple[Times, ...] = ()


class TierTiming(msgspec.Struct, frozen=True):
    """Sums over the processes of one tier, and the largest share and memory of one of them."""

    tier: str
    kind: Kind
    processes: int
    missed_deadlines: int
    missing_inputs: int
    old_inputs: int
    overruns: int
    skipped_cycles: int
    dropped: int | None
    cpu_percent: float | None
    cpu_highest_percent: float | None
    resident_mb: float | None


class RunTiming(NamedTuple):
    """The timing of a run, without devices among its processes.

    In a late cycle one of our agents missed a deadline, overran or said nothing. `loop_cycles` are
    those that the plant ended.
    """

    times: tuple[Times, ...]
    processes: tuple[ProcessTiming, ...]
    slowest: tuple[CycleWaits, ...]
    late_cycles: int
    loop_cycles: NDArray[np.int64]
    loop_ns: Durations
    clocks: tuple[ClockOffset, ...] = ()

    @property
    def cycles(self) -> int:
        return len(self.loop_cycles)


def run_timing(reader: RunReader, *, by_agent: bool = False) -> RunTiming:
    """Work out the timing of a run; with `by_agent` each agent has rows of its own too."""
    messages = read_message_times(reader)
    stages = stage_times(messages)
    if clocks := clock_offsets(messages, stages):
        messages = on_one_clock(messages, clocks)
        stages = stage_times(messages)
    measures = _Measures(messages, clocks)
    for _, own in groupby(stages, key=lambda stage: stage.agent):
        measures.see_agent(list(own))
    cycles, loop_ns, slowest = measures.see_loop()
    if by_agent:
        measures.processes = [replace(one, times=measures.rows(one)) for one in measures.processes]
    return RunTiming(
        times=measures.rows(),
        processes=tuple(measures.processes),
        slowest=tuple(cycle_waits(messages, stages, cycle) for cycle in slowest),
        late_cycles=int(measures.late.sum()),
        loop_cycles=cycles,
        loop_ns=loop_ns,
        clocks=clocks,
    )


class _Part(NamedTuple):
    """A part of a row: the row, its place in its measure, and the row of the agent alone."""

    measure: str
    of: str
    kind: str
    place: int
    durations_ns: Durations
    agent: str = ""
    own: str = ""


class _Measures:
    """Rows of durations, counts, and the cycles in which one of our agents was late."""

    def __init__(self, messages: MessageTimes, clocks: Sequence[ClockOffset]) -> None:
        self._messages = messages
        self._clocks = {clock.name for clock in clocks}
        self._plan, self._tree = messages.plan, messages.plan.tree
        self._parts: list[_Part] = []
        self.processes: list[ProcessTiming] = []
        self.late = np.zeros(len(messages.tick_ns), dtype=bool)

    def see_agent(self, stages: list[StageTimes]) -> None:
        """Measure the stages of an agent; of a device only what can be seen from outside."""
        for stage in stages:
            at = np.flatnonzero(stage.closed)
            expected_ns = np.diff(at) * self._plan.cycle_wall_ns
            self._add_stage("jitter", stage, abs(np.diff(stage.first_ns[at]) - expected_ns))
        if stages[0].agent in self._plan.external:
            for stage in stages:
                self._see_device(stage)
        else:
            self._see_own(stages)

    def _see_own(self, stages: list[StageTimes]) -> None:
        agent = stages[0].agent
        # When the agent had last spoken before each stage of each cycle.
        spoke_ns = np.column_stack([np.where(one.closed, one.last_ns, 0) for one in stages])
        latest_ns = np.maximum.accumulate(np.concatenate([[0], spoke_ns.ravel()]))
        before_ns = latest_ns[:-1].reshape(spoke_ns.shape)
        missed, overruns = Counter[str](), Counter[str]()
        slowest_ns = 0
        for stage, before in zip(stages, before_ns.T, strict=True):
            decision_ns = (stage.last_ns - stage.ready_ns)[stage.closed]
            self._add_stage("decision", stage, decision_ns)
            slowest_ns = max(slowest_ns, int(decision_ns.max(initial=0)))
            overran = self._see_deadline(stage)
            known = stage.closed & (stage.oldest_ns < NEVER)
            self._add_stage("age", stage, (stage.ready_ns - stage.oldest_ns)[known])
            self._see_hops(stage, before)
            missed[stage.name] += int(stage.lacking.sum())
            overruns[stage.name] += int(overran.sum())
            self.late |= stage.lacking | overran
        silent = ~np.logical_or.reduce([stage.closed for stage in stages])
        self.late |= silent
        self.processes.append(
            ProcessTiming(
                agent=agent,
                tier=tier_of(agent, self._tree),
                kind=kind_of(agent, self._tree),
                missed_deadlines=dict(+missed),
                missing_inputs=dict(self._messages.missed.missing[agent]),
                old_inputs=self._messages.missed.old[agent],
                overruns=dict(+overruns),
                skipped_cycles=int(silent.sum()),
                slowest_decision_us=slowest_ns / 1e3,
            )
        )

    def _see_deadline(self, stage: StageTimes) -> NDArray[np.bool_]:
        """Measure how late the clock closed a stage; return the cycles in which it overran."""
        deadlines = self._plan.deadlines
        deadline_ns = self._messages.tick_ns + deadlines.deadline_ns(stage.agent, stage.name)
        by_clock = stage.closed if stage.timed else stage.lacking
        self._add_stage("lateness", stage, (stage.first_ns - deadline_ns)[by_clock])
        # The plant's tick is when its first stage begins, not when it must end.
        grace_ns = deadlines.slice_ns(stage.agent, stage.name) if stage.timed else 0
        overran: NDArray[np.bool_] = stage.last_ns > deadline_ns + grace_ns
        return overran & stage.closed & ~stage.lacking

    def _see_hops(self, stage: StageTimes, before_ns: Durations) -> None:
        """Measure the hop of the input that completed a stage, if the agent was waiting for it."""
        waited = (stage.completed_ns > 0) & ~stage.lacking & (stage.ready_ns >= before_ns)
        for place, port in enumerate(stage.inputs):
            at = waited & (stage.cause == place)
            hop_ns = (stage.ready_ns - stage.completed_ns)[at]
            order = SIGNALS.index(port.signal)
            ends = {clock_of(agent, self._plan) for agent in (stage.agent, port.publisher)}
            mark = ACROSS if len(ends) > 1 and ends & self._clocks else ""
            signal = f"{port.signal.name}{mark}"
            self._add(_Part("hop", signal, signal, order, hop_ns, stage.agent, f"{port}{mark}"))
            if port.publisher in self._plan.external and port.publisher != PLANT:
                row = f"{port.signal.name} of {port.publisher}{mark}"
                self._add(_Part("hop", row, signal, order, hop_ns))

    def _see_device(self, stage: StageTimes) -> None:
        """Measure from outside how long a device took to answer."""
        completed = stage.completed_ns > 0
        began_ns = np.where(completed, stage.completed_ns, self._messages.tick_ns)
        answered = stage.closed & (completed | stage.timed)
        place = stage_place(stage.agent, stage.name, self._tree)
        row, kind = f"{stage.agent} {stage.name}", kind_of(stage.agent, self._tree)
        self._add(_Part("response", row, kind, place, (stage.last_ns - began_ns)[answered]))

    def see_loop(self) -> tuple[NDArray[np.int64], Durations, list[int]]:
        """Measure the loop; return the cycles that ended, their loop times, and the slowest."""
        tick_ns = self._messages.tick_ns
        for leaf in self._tree.leaves:
            command_ns = self._messages.published_ns(COMMAND.of(leaf))
            times_ns = (command_ns - tick_ns)[command_ns > 0]
            self._add(_Part(LOOP, EVERY_COMMAND, "", 1, times_ns, PLANT, leaf))
        production = PRODUCTION.of(ROOT)
        published_ns = applied_ns = self._messages.published_ns(production)
        if PLANT not in self._plan.external:
            applied_ns = self._messages.ready_ns[:, self._messages.columns[production]]
        cycles = np.flatnonzero(published_ns)
        loop_ns = (applied_ns - tick_ns)[cycles]
        self._add(_Part(LOOP, WHOLE_LOOP, "", 0, loop_ns, PLANT))
        slowest = np.argsort((tick_ns - published_ns)[cycles], kind="stable")[:SLOWEST]
        return cycles, loop_ns, [int(cycle) for cycle in cycles[slowest]]

    def _add_stage(self, measure: str, stage: StageTimes, durations_ns: Durations) -> None:
        agent, place = stage.agent, stage_place(stage.agent, stage.name, self._tree)
        row, kind = f"{tier_of(agent, self._tree)} {stage.name}", kind_of(agent, self._tree)
        self._add(_Part(measure, row, kind, place, durations_ns, agent, stage.name))

    def _add(self, part: _Part) -> None:
        if len(part.durations_ns):
            self._parts.append(part)

    def rows(self, process: ProcessTiming | None = None) -> tuple[Times, ...]:
        """Return the rows by tier and signal, or those of one of our own agents alone.

        They come by measure, then in the order of a cycle; those of an agent by name.
        """
        outside = {"response", LOOP} if PLANT in self._plan.external else {"response"}
        parts = self._parts
        if process is not None:
            parts = [
                part._replace(of=part.own, kind=process.kind, place=0)
                for part in parts
                if part.agent == process.agent
            ]

        def row(part: _Part) -> tuple[int, int, str]:
            return MEASURES.index(part.measure), part.place, part.of

        found = []
        for _, group in groupby(sorted(parts, key=row), row):
            members = list(group)
            measure, of, kind = members[0].measure, members[0].of, members[0].kind
            durations = distribution(np.concatenate([part.durations_ns for part in members]))
            found.append(Times(measure, of, kind, durations, measure in outside))
        return tuple(found)


def tier_of(agent: str, tree: ControlTree) -> str:
    """Return an agent's kind; supervisors of several tiers have a number, 1 below the centre."""
    kind = kind_of(agent, tree)
    several = len({depth(path) for path in tree.parents if path}) > 1
    return f"{kind} {depth(agent)}" if kind == "supervisor" and several else kind


def with_accounts(
    processes: Iterable[ProcessTiming],
    accounts: Iterable[ProcessAccount],
    wall_s: float,
    tree: ControlTree,
) -> tuple[ProcessTiming, ...]:
    """Add what the launcher knows of each process; the recorder is known to it alone."""
    found = {process.agent: process for process in processes}
    for account in accounts:
        name, cpu_s = account.agent, account.cpu_s
        bare = ProcessTiming(agent=name, tier=tier_of(name, tree), kind=kind_of(name, tree))
        found[name] = replace(
            found.get(name, bare),
            dropped=account.dropped,
            resident_mb=account.resident_mb,
            cpu_percent=None if cpu_s is None or wall_s <= 0.0 else 100.0 * cpu_s / wall_s,
        )
    return tuple(found.values())


def tier_timings(processes: Iterable[ProcessTiming]) -> tuple[TierTiming, ...]:
    def tier(process: ProcessTiming) -> tuple[int, str]:
        return KINDS.index(process.kind), process.tier

    return tuple(_tier(list(members)) for _, members in groupby(sorted(processes, key=tier), tier))


def _tier(members: Sequence[ProcessTiming]) -> TierTiming:
    shares = _known(one.cpu_percent for one in members)
    memory = _known(one.resident_mb for one in members)
    return TierTiming(
        tier=members[0].tier,
        kind=members[0].kind,
        processes=len(members),
        missed_deadlines=sum(sum(one.missed_deadlines.values()) for one in members),
        missing_inputs=sum(sum(one.missing_inputs.values()) for one in members),
        old_inputs=sum(one.old_inputs for one in members),
        overruns=sum(sum(one.overruns.values()) for one in members),
        skipped_cycles=sum(one.skipped_cycles for one in members),
        dropped=total(count_of(one.dropped) for one in members),
        cpu_percent=total(shares),
        cpu_highest_percent=max(shares, default=None),
        resident_mb=max(memory, default=None),
    )


def count_of(causes: dict[str, int] | None) -> int | None:
    """Return the sum of counts by cause; None if they are not known."""
    return None if causes is None else sum(causes.values())


def total(values: Iterable[N | None]) -> N | None:
    """Return the sum of the known values; None if none is known."""
    known = _known(values)
    return sum(known[1:], start=known[0]) if known else None


def _known(values: Iterable[N | None]) -> list[N]:
    return [value for value in values if value is not None]
