"""What a run in real time measured: rows of durations, and counts of each process.

docs/timing.md defines each measure.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Final, NamedTuple

import msgspec
import numpy as np
import pandas as pd
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.cycle import KINDS, Kind, kind_of, stage_place
from agents.plan import RunPlan
from bus_schemas.signals import COMMAND, PRODUCTION, SIGNALS
from bus_schemas.tree import PLANT, ROOT, ControlTree, depth
from recordings.read.reader import RunReader
from results.run_summary import ProcessAccount
from results.timing.clocks import ACROSS, ClockOffset, clock_of, clock_offsets, on_one_clock
from results.timing.cycle_waits import CycleWaits, cycle_waits
from results.timing.stage_times import MessageTimes, StageTimes, read_message_times, stage_times

LOOP: Final = "loop"
WHOLE_LOOP: Final = "all commands"
EVERY_COMMAND: Final = "each command"

MEASURES: Final = (LOOP, "decision", "hop", "lateness", "jitter", "age", "response")
"""What is measured, in the order in which it is reported."""

SLOWEST: Final = 3
"""How many of the slowest cycles are looked into."""

_STEPS_PER_DECADE: Final = 12
"""How finely a curve is drawn: between 90 and 99 % as between 99 and 99.9 %."""


class Distribution(msgspec.Struct, frozen=True):
    """A summary of durations. A percentile is the least one that so many percent do not exceed.

    `curve_us` are those that shares of `curve_shares` exceed.
    """

    count: int
    min_us: float
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float
    curve_us: tuple[float, ...]


class Times(msgspec.Struct, frozen=True):
    """A row of durations: `decision` of `direct estimate`, `hop` of `residual`.

    `kind` is that of the agents, or the signal, and names the budget if `of` does not.
    """

    measure: str
    of: str
    kind: str
    times: Distribution


def curve_shares(count: int) -> NDArray[np.float64]:
    """Return shares from 1 down to half of one of so many, in equal steps of their logarithm."""
    steps = np.arange(int(_STEPS_PER_DECADE * np.log10(2.0 * count)) + 1)
    return np.asarray(10.0 ** (-steps / _STEPS_PER_DECADE))


def distribution(durations_ns: NDArray[np.int64]) -> Distribution:
    """Summarise one duration or more; below 0 counts as 0."""
    count = len(durations_ns)
    levels = np.concatenate(([0.0, 0.5, 0.99, 0.999, 1.0], 1.0 - curve_shares(count)))
    found_ns = np.quantile(durations_ns.clip(0), levels, method="inverted_cdf")
    min_us, p50_us, p99_us, p99_9_us, max_us, *curve_us = (found_ns / 1e3).tolist()
    return Distribution(count, min_us, p50_us, p99_us, p99_9_us, max_us, tuple(curve_us))


class Counts(msgspec.Struct, frozen=True, kw_only=True):
    """What went wrong in the cycles of a process, or of all processes of a tier."""

    missed_deadlines: int = 0
    missing_inputs: int = 0
    overruns: int = 0
    skipped_cycles: int = 0


class ProcessTiming(Counts, frozen=True, kw_only=True):
    """Counts and resources of one process; None: known to its launcher alone.

    Processor time is in % of one core.
    """

    agent: str
    tier: str
    kind: Kind
    dropped: int | None = None
    cpu_percent: float | None = None
    resident_mb: float | None = None
    times: tuple[Times, ...] = ()


class TierTiming(Counts, frozen=True, kw_only=True):
    """Sums over the processes of one tier, and the largest share and memory of one of them."""

    tier: str
    kind: Kind
    processes: int
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
    if PLANT not in plan.access.external:
        loop_ns = messages.ready_ns[production].loc[loop_ns.index]
    durations = [*_loop_durations(messages, loop_ns)]
    processes: list[ProcessTiming] = []
    late: set[int] = set()
    for agent, group in groupby(stages, key=lambda stage: stage.agent):
        own = list(group)
        durations += _stage_durations(plan, own, {clock.name for clock in clocks})
        if agent in plan.access.external:
            continue
        closed = pd.concat([stage.closed for stage in own])
        silent = messages.publish_ns.index.difference(closed.index)
        late.update(silent, closed.index[closed.lacking | closed.overran])
        rows = [one for one in durations if by_agent and one.agent == agent]
        processes.append(
            ProcessTiming(
                agent=agent,
                tier=tier_of(agent, plan.tree),
                kind=kind_of(agent, plan.tree),
                missed_deadlines=int(closed.lacking.sum()),
                missing_inputs=messages.missed.missing[agent].total(),
                overruns=int(closed.overran.sum()),
                skipped_cycles=len(silent),
                times=_rows(rows),
            )
        )
    return RunTiming(
        times=_rows(durations),
        processes=tuple(processes),
        slowest=tuple(cycle_waits(messages, stages, cycle) for cycle in slowest.tolist()),
        late_cycles=len(late),
        loop_ns=loop_ns,
        clocks=clocks,
    )


class _Durations(NamedTuple):
    """Durations of one agent, and the row in which they are reported with those of others.

    `order` is that of the row among the rows of its measure.
    """

    measure: str
    order: int
    of: str
    kind: str
    agent: str
    ns: pd.Series


def _loop_durations(messages: MessageTimes, loop_ns: pd.Series) -> Iterator[_Durations]:
    yield _Durations(LOOP, 0, WHOLE_LOOP, "", PLANT, loop_ns)
    for leaf in messages.plan.tree.leaves:
        command_ns = messages.publish_ns[COMMAND.of(leaf)]
        yield _Durations(LOOP, 1, EVERY_COMMAND, "", leaf, command_ns)


def _stage_durations(
    plan: RunPlan, stages: Sequence[StageTimes], clocks: set[str]
) -> Iterator[_Durations]:
    """Measure the stages of an agent; of a device only what can be seen from outside."""
    agent = stages[0].agent
    tier, kind = tier_of(agent, plan.tree), kind_of(agent, plan.tree)
    ticks_ns = {one.name: one.closed.index * plan.timing.cycle_wall_ns for one in stages}
    # When the agent had last published before each stage of each cycle.
    spoke_ns = pd.DataFrame({one.name: one.closed.last_ns + ticks_ns[one.name] for one in stages})
    latest_ns = spoke_ns.stack().dropna().cummax().shift().unstack()
    before_ns = pd.DataFrame(latest_ns, spoke_ns.index, spoke_ns.columns)
    for stage in stages:
        closed, order = stage.closed, stage_place(agent, stage.name, plan.tree)
        row = order, f"{tier} {stage.name}", kind, agent
        yield _Durations("jitter", *row, closed.first_ns.diff().abs())
        if agent in plan.access.external:
            answered = closed if stage.timed else closed[closed.completed_ns.notna()]
            took_ns = answered.last_ns - answered.completed_ns.fillna(0.0)
            yield _Durations("response", order, f"{agent} {stage.name}", kind, agent, took_ns)
            continue
        yield _Durations("decision", *row, closed.last_ns - closed.ready_ns)
        by_clock = closed if stage.timed else closed[closed.lacking]
        yield _Durations("lateness", *row, by_clock.first_ns - stage.deadline_ns)
        yield _Durations("age", *row, closed.ready_ns - closed.oldest_ns)
        was_busy = before_ns[stage.name].loc[closed.index] > closed.ready_ns + ticks_ns[stage.name]
        yield from _hop_durations(plan, agent, closed[~was_busy & ~closed.lacking], clocks)


def _hop_durations(
    plan: RunPlan, agent: str, waited: pd.DataFrame, clocks: set[str]
) -> Iterator[_Durations]:
    """Measure the hop of the input that completed a stage, if the agent waited for it."""
    hops_ns = (waited.ready_ns - waited.completed_ns).dropna()
    for port, hop_ns in hops_ns.groupby(waited.cause, sort=False):
        signal, publisher = port.signal.name, port.publisher
        order = SIGNALS.index(port.signal)
        ends = {clock_of(one, plan) for one in (agent, publisher)}
        mark = ACROSS if len(ends) > 1 and ends & clocks else ""
        kind = f"{signal}{mark}"
        yield _Durations("hop", order, kind, kind, agent, hop_ns)
        if publisher in plan.access.external and publisher != PLANT:
            of = f"{signal} of {publisher}{mark}"
            yield _Durations("hop", order, of, kind, publisher, hop_ns)


def _rows(durations: Iterable[_Durations]) -> tuple[Times, ...]:
    """Return the rows of durations: by measure, then by order and name."""
    rows: dict[tuple[int, int, str, str], list[pd.Series]] = defaultdict(list)
    for measure, order, of, kind, _, ns in durations:
        if len(known_ns := ns.dropna()):
            rows[MEASURES.index(measure), order, of, kind].append(known_ns)
    times = []
    for (number, _, of, kind), many_ns in sorted(rows.items(), key=itemgetter(0)):
        summary = distribution(np.concatenate(many_ns).astype(np.int64))
        times.append(Times(MEASURES[number], of, kind, summary))
    return tuple(times)


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
    by_agent = {process.agent: process for process in processes}
    for account in accounts:
        name, cpu_s = account.agent, account.cpu_s
        bare = ProcessTiming(agent=name, tier=tier_of(name, tree), kind=kind_of(name, tree))
        by_agent[name] = replace(
            by_agent.get(name, bare),
            dropped=sum(account.dropped.values()),
            resident_mb=account.resident_mb,
            cpu_percent=None if cpu_s is None or wall_s <= 0.0 else 100.0 * cpu_s / wall_s,
        )
    return tuple(by_agent.values())


def tier_timings(processes: Iterable[ProcessTiming]) -> tuple[TierTiming, ...]:
    def tier(process: ProcessTiming) -> tuple[int, str]:
        return KINDS.index(process.kind), process.tier

    return tuple(_tier(list(members)) for _, members in groupby(sorted(processes, key=tier), tier))


def _tier(members: Sequence[ProcessTiming]) -> TierTiming:
    cpu = [one.cpu_percent for one in members if one.cpu_percent is not None]
    memory = [one.resident_mb for one in members if one.resident_mb is not None]
    dropped = [one.dropped for one in members if one.dropped is not None]
    return TierTiming(
        tier=members[0].tier,
        kind=members[0].kind,
        processes=len(members),
        **{name: sum(getattr(one, name) for one in members) for name in Counts.__struct_fields__},
        dropped=sum(dropped) if dropped else None,
        cpu_percent=sum(cpu) if cpu else None,
        cpu_highest_percent=max(cpu, default=None),
        resident_mb=max(memory, default=None),
    )
