"""What a run in real time measured: rows of durations, and counts of each process.

docs/timing.md defines each measure.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Final, NamedTuple, TypeVar

import msgspec
import numpy as np
import pandas as pd
from msgspec.structs import replace

from agents.cycle import KINDS, Kind, kind_of, stage_place
from agents.plan import RunPlan
from bus_schemas.signals import COMMAND, PRODUCTION, SIGNALS
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from launch_scripts.launcher.summary import ProcessAccount
from recordings.read.reader import RunReader
from studies.timing.clocks import ACROSS, ClockOffset, clock_of, clock_offsets, on_one_clock
from studies.timing.cycle_waits import CycleWaits, cycle_waits
from studies.timing.durations import Times, distribution
from studies.timing.stage_times import (
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
    """The timing of a run; `processes` has no devices.

    In a late cycle one of Heliarch's agents missed a deadline, overran or published nothing.
    `loop_ns` has the cycles that the plant ended.
    """

    times: tuple[Times, ...]
    processes: tuple[ProcessTiming, ...]
    slowest: tuple[CycleWaits, ...]
    late_cycles: int
    loop_ns: pd.Series
    clocks: tuple[ClockOffset, ...] = ()

    @property
    def cycles(self) -> int:
        return len(self.loop_ns)


def run_timing(reader: RunReader, *, by_agent: bool = False) -> RunTiming:
    """Work out the timing of a run; with `by_agent` each agent has rows of its own too."""
    messages = read_message_times(reader)
    stages = stage_times(messages)
    if clocks := clock_offsets(messages, stages):
        messages = on_one_clock(messages, clocks)
        stages = stage_times(messages)
    plan = messages.plan
    production = PRODUCTION.of(ROOT)
    loop_ns = messages.publish_ns[production].dropna()
    slowest = loop_ns.nlargest(SLOWEST).index
    if PLANT not in plan.external:
        loop_ns = messages.ready_ns[production].loc[loop_ns.index]
    durations = [*_loop_durations(messages, loop_ns)]
    processes: list[ProcessTiming] = []
    late: set[int] = set()
    for agent, group in groupby(stages, key=lambda stage: stage.agent):
        own = list(group)
        durations += _stage_durations(plan, own, {clock.name for clock in clocks})
        if agent in plan.external:
            continue
        closed = pd.concat([stage.closed for stage in own])
        silent = messages.publish_ns.index.difference(closed.index)
        late.update(silent, closed.index[closed.lacking | closed.overran])
        processes.append(
            ProcessTiming(
                agent=agent,
                tier=tier_of(agent, plan.tree),
                kind=kind_of(agent, plan.tree),
                missed_deadlines=_counts({one.name: one.closed.lacking for one in own}),
                missing_inputs=dict(messages.missed.missing[agent]),
                old_inputs=messages.missed.old[agent],
                overruns=_counts({one.name: one.closed.overran for one in own}),
                skipped_cycles=len(silent),
                slowest_decision_us=max(0.0, float((closed.last_ns - closed.ready_ns).max())) / 1e3,
            )
        )
    if by_agent:
        processes = [replace(one, times=_rows_of(one, durations, plan)) for one in processes]
    return RunTiming(
        times=_rows(durations, plan),
        processes=tuple(processes),
        slowest=tuple(cycle_waits(messages, stages, cycle) for cycle in slowest.tolist()),
        late_cycles=len(late),
        loop_ns=loop_ns,
        clocks=clocks,
    )


def _counts(by_stage: dict[str, pd.Series]) -> dict[str, int]:
    """Count for each stage the cycles in which a condition holds, if there are any."""
    return {stage: int(holds.sum()) for stage, holds in by_stage.items() if holds.any()}


class _Durations(NamedTuple):
    """Durations, and where they are reported.

    They are in a row for all agents, with its place among the rows of its measure, and in the row
    `own` of one agent.
    """

    measure: str
    place: int
    of: str
    kind: str
    ns: pd.Series
    agent: str = ""
    own: str = ""


def _loop_durations(messages: MessageTimes, loop_ns: pd.Series) -> Iterator[_Durations]:
    yield _Durations(LOOP, 0, WHOLE_LOOP, "", loop_ns, PLANT)
    for leaf in messages.plan.tree.leaves:
        command_ns = messages.publish_ns[COMMAND.of(leaf)]
        yield _Durations(LOOP, 1, EVERY_COMMAND, "", command_ns, PLANT, leaf)


def _stage_durations(
    plan: RunPlan, stages: Sequence[StageTimes], clocks: set[str]
) -> Iterator[_Durations]:
    """Measure the stages of an agent; of a device only what can be seen from outside."""
    cycle_ns, agent = plan.cycle_wall_ns, stages[0].agent
    # When the agent had last published before each stage of each cycle.
    spoke_ns = pd.DataFrame(
        {at: one.closed.last_ns + one.closed.index * cycle_ns for at, one in enumerate(stages)}
    )
    latest_ns = np.fmax.accumulate([-np.inf, *spoke_ns.to_numpy().flat])
    before_ns = pd.DataFrame(latest_ns[:-1].reshape(spoke_ns.shape), spoke_ns.index)
    tier, kind = tier_of(agent, plan.tree), kind_of(agent, plan.tree)
    for at, stage in enumerate(stages):
        closed, own = stage.closed, (agent, stage.name)
        place = stage_place(agent, stage.name, plan.tree)
        row = place, f"{tier} {stage.name}", kind
        yield _Durations("jitter", *row, closed.first_ns.diff().abs(), *own)
        if agent in plan.external:
            answered = closed if stage.timed else closed[closed.completed_ns.notna()]
            took_ns = answered.last_ns - answered.completed_ns.fillna(0.0)
            yield _Durations("response", place, f"{agent} {stage.name}", kind, took_ns)
            continue
        yield _Durations("decision", *row, closed.last_ns - closed.ready_ns, *own)
        by_clock = closed if stage.timed else closed[closed.lacking]
        yield _Durations("lateness", *row, by_clock.first_ns - stage.deadline_ns, *own)
        yield _Durations("age", *row, closed.ready_ns - closed.oldest_ns, *own)
        was_free = closed.ready_ns + closed.index * cycle_ns >= before_ns.loc[closed.index, at]
        yield from _hop_durations(plan, agent, closed[was_free & ~closed.lacking], clocks)


def _hop_durations(
    plan: RunPlan, agent: str, waited: pd.DataFrame, clocks: set[str]
) -> Iterator[_Durations]:
    """Measure the hop of the input that completed a stage, if the agent waited for it."""
    hops_ns = (waited.ready_ns - waited.completed_ns).dropna()
    for port, hop_ns in hops_ns.groupby(waited.cause, sort=False):
        signal, publisher, place = port.signal.name, port.publisher, SIGNALS.index(port.signal)
        ends = {clock_of(one, plan) for one in (agent, publisher)}
        mark = ACROSS if len(ends) > 1 and ends & clocks else ""
        kind = f"{signal}{mark}"
        yield _Durations("hop", place, kind, kind, hop_ns, agent, f"{port}{mark}")
        if publisher in plan.external and publisher != PLANT:
            yield _Durations("hop", place, f"{signal} of {publisher}{mark}", kind, hop_ns)


def _rows(found: Iterable[_Durations], plan: RunPlan) -> tuple[Times, ...]:
    """Return the rows of durations: by measure, then by place and name."""
    outside = {"response", LOOP} if PLANT in plan.external else {"response"}
    rows: dict[tuple[int, int, str, str], list[pd.Series]] = defaultdict(list)
    for measure, place, of, kind, ns, *_ in found:
        if len(known_ns := ns.dropna()):
            rows[MEASURES.index(measure), place, of, kind].append(known_ns)
    times = []
    for (number, _, of, kind), many_ns in sorted(rows.items(), key=itemgetter(0)):
        summary = distribution(np.concatenate(many_ns).astype(np.int64))
        times.append(Times(MEASURES[number], of, kind, summary, MEASURES[number] in outside))
    return tuple(times)


def _rows_of(
    process: ProcessTiming, found: Iterable[_Durations], plan: RunPlan
) -> tuple[Times, ...]:
    """Return the rows of one process: by measure, then by name."""
    own = (one for one in found if one.agent == process.agent)
    return _rows((one._replace(place=0, of=one.own, kind=process.kind) for one in own), plan)


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
