"""What a run in real time measured: rows of durations, and counts of each process.

docs/timing.md defines each measure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.cycle import kind_of, stage_place
from bus_schemas.signals import COMMAND, PRODUCTION, SIGNALS
from bus_schemas.tree import PLANT, ROOT
from recordings.read.reader import RunReader
from studies.timing.clocks import ACROSS, ClockOffset, clock_of, clock_offsets, on_one_clock
from studies.timing.cycle_waits import CycleWaits, cycle_waits
from studies.timing.durations import Distribution, Times, distribution
from studies.timing.processes import ProcessTiming, tier_of
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
        """How many cycles the plant ended."""
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
    return RunTiming(
        times=measures.rows(),
        processes=tuple(
            replace(one, times=measures.rows_of(one)) if by_agent else one
            for one in measures.processes
        ),
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
    agent: str
    own: str
    durations_ns: Durations


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
        """Measure the stages of an agent."""
        agent = stages[0].agent
        for stage in stages:
            at = np.flatnonzero(stage.closed)
            expected_ns = np.diff(at) * self._plan.cycle_wall_ns
            self._add_stage("jitter", stage, abs(np.diff(stage.first_ns[at]) - expected_ns))
            if agent in self._plan.external:
                self._see_device(stage)
        if agent in self._plan.external:
            return
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
            self._add(_Part("hop", signal, signal, order, stage.agent, f"{port}{mark}", hop_ns))
            if port.publisher in self._plan.external and port.publisher != PLANT:
                row = f"{port.signal.name} of {port.publisher}{mark}"
                self._add(_Part("hop", row, signal, order, "", "", hop_ns))

    def _see_device(self, stage: StageTimes) -> None:
        """Measure from outside how long a device took to answer."""
        completed = stage.completed_ns > 0
        began_ns = np.where(completed, stage.completed_ns, self._messages.tick_ns)
        answered = stage.closed & (completed | stage.timed)
        place = stage_place(stage.agent, stage.name, self._tree)
        row, kind = f"{stage.agent} {stage.name}", kind_of(stage.agent, self._tree)
        response_ns = (stage.last_ns - began_ns)[answered]
        self._add(_Part("response", row, kind, place, "", "", response_ns))

    def see_loop(self) -> tuple[NDArray[np.int64], Durations, list[int]]:
        """Measure the loop; return the cycles that ended, their loop times, and the slowest."""
        tick_ns = self._messages.tick_ns
        for leaf in self._tree.leaves:
            command_ns = self._messages.published_ns(COMMAND.of(leaf))
            times_ns = (command_ns - tick_ns)[command_ns > 0]
            self._add(_Part(LOOP, EVERY_COMMAND, "", 1, PLANT, leaf, times_ns))
        production = PRODUCTION.of(ROOT)
        published_ns = applied_ns = self._messages.published_ns(production)
        if PLANT not in self._plan.external:
            applied_ns = self._messages.ready_ns[:, self._messages.columns[production]]
        cycles = np.flatnonzero(published_ns)
        loop_ns = (applied_ns - tick_ns)[cycles]
        self._add(_Part(LOOP, WHOLE_LOOP, "", 0, PLANT, "", loop_ns))
        slowest = np.argsort((tick_ns - published_ns)[cycles], kind="stable")[:SLOWEST]
        return cycles, loop_ns, [int(cycle) for cycle in cycles[slowest]]

    def _add_stage(self, measure: str, stage: StageTimes, durations_ns: Durations) -> None:
        agent, place = stage.agent, stage_place(stage.agent, stage.name, self._tree)
        row, kind = f"{tier_of(agent, self._tree)} {stage.name}", kind_of(agent, self._tree)
        self._add(_Part(measure, row, kind, place, agent, stage.name, durations_ns))

    def _add(self, part: _Part) -> None:
        if len(part.durations_ns):
            self._parts.append(part)

    def rows(self) -> tuple[Times, ...]:
        """Return the rows by tier and signal: by measure, then in the order of a cycle."""
        outside = {"response", LOOP} if PLANT in self._plan.external else {"response"}
        rows: dict[tuple[str, str], list[_Part]] = {}
        for part in self._parts:
            rows.setdefault((part.measure, part.of), []).append(part)
        found = [
            (parts[0].place, Times(measure, of, parts[0].kind, _all_of(parts), measure in outside))
            for (measure, of), parts in rows.items()
        ]
        found.sort(key=lambda entry: (MEASURES.index(entry[1].measure), entry[0], entry[1].of))
        return tuple(row for _, row in found)

    def rows_of(self, process: ProcessTiming) -> tuple[Times, ...]:
        """Return the rows of one of our own agents."""
        own = [part for part in self._parts if part.agent == process.agent]
        own.sort(key=lambda part: (MEASURES.index(part.measure), part.own))
        return tuple(
            Times(measure, of, process.kind, _all_of(parts))
            for (measure, of), parts in groupby(own, key=lambda part: (part.measure, part.own))
        )


def _all_of(parts: Iterable[_Part]) -> Distribution:
    return distribution(np.concatenate([part.durations_ns for part in parts]))
