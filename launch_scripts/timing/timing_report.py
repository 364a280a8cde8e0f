"""What a timed run came to, as one document: all that the table, the page and the JSON say."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import msgspec

from agents.events import ExternalAccount
from agents.histograms import new_histogram, record_ns
from agents.kinds import STAGES
from agents.plan import RunPlan
from agents.stopwatch import ProcessTiming
from bus_schemas.errors import InputError
from bus_schemas.signals import Occurrence, listeners, ports
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.summary import ProcessAccount
from launch_scripts.supervision import RunFailure
from launch_scripts.timing.budgets import Verdict, budgets_of, judge
from launch_scripts.timing.distributions import distribution
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.host import Host
from launch_scripts.timing.measured_run import MeasuredRun
from launch_scripts.timing.measures import (
    LOOP,
    MEASURES,
    WHOLE_LOOP,
    TierAccount,
    Tiers,
    Times,
    cpu_percent,
    distribution_of,
    tier_accounts,
    times_by_tier,
    times_of,
)
from launch_scripts.wrong_messages import WrongMessages
from recordings.cycle_waits import (
    CycleWaits,
    last_cycle_with_all,
    loop_times_ns,
    response_times_ns,
    slowest_cycles,
)
from recordings.reader import RunReader

SLOWEST: Final = 3
"""How many of the slowest cycles are looked into."""


class ProcessTimes(msgspec.Struct, frozen=True):
    """What one process measured of itself.

    Attributes
    ----------
    agent, tier
        Its name and tier.
    policy
        Scheduling policy and processors that it really had.
    cpu_percent
        Processor time [% of one core].
    resident_mb
        Most memory that was resident [MB].
    switches_voluntary, switches_involuntary
        How often it gave the processor up, and how often it was taken from it.
    missed_deadlines, overruns
        By stage.
    missing_inputs
        By port.
    late_used
        Words of earlier cycles that stood in for absent ones.
    cycles_given_up
        Cycles that were over before it came to them.
    dropped
        Messages that could not be used, by cause.
    times
        Its durations, row by row.
    """

    agent: str
    tier: str
    policy: str
    cpu_percent: float
    resident_mb: float
    switches_voluntary: int
    switches_involuntary: int
    missed_deadlines: dict[str, int]
    overruns: dict[str, int]
    missing_inputs: dict[str, int]
    late_used: int
    cycles_given_up: int
    dropped: dict[str, int]
    times: tuple[Times, ...]


class SlowCycle(msgspec.Struct, frozen=True):
    """One of the slowest cycles, and what made it slow."""

    cycle: int
    loop_us: float
    slowest_agent: str
    slowest_stage: str
    slowest_us: float
    text: str


class TimingReport(msgspec.Struct, frozen=True):
    """A timed run.

    Attributes
    ----------
    scenario, run_id, folder
        What was run, and where its recording is.
    host
        What it was run on.
    rate_hz, cycles, wall_s
        Cycles a second, how many, and how long they took.
    interrupted
        Whether the user ended it early.
    remarks
        What is to be known of the run besides: what the machine did not permit, a recording that
        ended early.
    external
        What was heard of the user's own devices.
    wrong
        Messages of theirs that could not be used, by key and cause.
    faults
        What the faults of the network did to messages, if there were any.
    lost_messages
        Messages that were published and are not in the recording.
    times
        Durations by tier and stage, and by signal, of all processes together.
    tiers
        Counts and shares by tier.
    processes
        Process by process.
    floor
        What the machine itself needs.
    slowest_cycles
        The slowest first.
    verdicts
        Budget by budget.
    """

    scenario: str
    run_id: str
    folder: str
    host: Host
    rate_hz: float
    cycles: int
    wall_s: float
    interrupted: bool
    remarks: tuple[str, ...]
    external: tuple[ExternalAccount, ...]
    wrong: tuple[WrongMessages, ...]
    faults: dict[str, int]
    lost_messages: int
    times: tuple[Times, ...]
    tiers: tuple[TierAccount, ...]
    processes: tuple[ProcessTimes, ...]
    floor: tuple[FloorTimes, ...]
    slowest_cycles: tuple[SlowCycle, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def passed(self) -> bool:
        """Whether every budget was kept."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def clean(self) -> bool:
        """Whether the plant kept up: no deadline missed, no overrun, nothing given up or lost."""
        late = sum(
            tier.missed_deadlines + tier.overruns + tier.cycles_given_up for tier in self.tiers
        )
        return self.cycles > 0 and late == 0 and self.lost_messages == 0

    def as_json(self) -> bytes:
        """Return the report as JSON, with the verdict on all of it."""
        document = {"passed": self.passed, "clean": self.clean, **msgspec.to_builtins(self)}
        return msgspec.json.format(msgspec.json.encode(document), indent=1)


def report_on(run: MeasuredRun) -> tuple[TimingReport, tuple[CycleWaits, ...]]:
    """Work out the report of a run, and the waits of its slowest cycles.

    Raises
    ------
    RunFailure
        Its recording cannot be read.
    """
    plan, summary = run.plan, run.summary
    timings = [account.timing for account in summary.processes if account.timing is not None]
    slowest, seen = _recorded(run)
    times = _in_order((*times_by_tier(timings, plan.tree), *_hops_from(timings, plan), *seen))
    tiers = tier_accounts(summary.processes, plan.tree)
    budgets, expected = budgets_of(plan, run.budgets), _expected(plan, timings)
    report = TimingReport(
        scenario=summary.scenario,
        run_id=summary.run_id,
        folder=summary.folder,
        host=run.host,
        rate_hz=1e9 / plan.cycle_wall_ns,
        cycles=summary.cycles,
        wall_s=summary.wall_s,
        interrupted=summary.interrupted,
        remarks=(*summary.remarks, *([summary.recording_ended] * bool(summary.recording_ended))),
        external=summary.external,
        wrong=summary.wrong,
        faults=summary.faults,
        lost_messages=summary.lost,
        times=times,
        tiers=tiers,
        processes=_process_times(summary.processes, plan),
        floor=run.floor,
        slowest_cycles=tuple(_slow_cycle(cycle) for cycle in slowest),
        verdicts=judge(budgets, times, tiers, summary.lost, expected),
    )
    return report, slowest


def _recorded(run: MeasuredRun) -> tuple[tuple[CycleWaits, ...], list[Times]]:
    """Return what the recording tells: the slowest cycles, and rows of external agents.

    That is nothing where the recording ended, with a full disk, before it could be read.
    """
    plan = run.plan
    try:
        with RunReader(run.recording) as reader:
            last_cycle = _last_cycle(reader, plan, interrupted=run.summary.interrupted)
            slowest = tuple(slowest_cycles(reader, SLOWEST, last_cycle))
            rows = [*_responses(response_times_ns(reader, plan.external, last_cycle), plan)]
            if PLANT in plan.external:
                rows += _outside_rows(LOOP, WHOLE_LOOP, "", loop_times_ns(reader, last_cycle))
    except InputError as error:
        if not run.summary.recording_ended:
            raise RunFailure(str(error)) from None
        return (), []  # What the processes measured of themselves needs no recording.
    return slowest, rows


def _expected(plan: RunPlan, timings: Sequence[ProcessTiming]) -> set[tuple[str, str]]:
    """Measure, and row, kind or signal, of what this run must have measured if it was at work."""
    tiers = Tiers(plan.tree)
    expected = {("decision", tiers.kind(timing.agent)) for timing in timings}
    expected |= {
        ("response", f"{agent} {stage}")
        for agent in plan.external
        for stage in STAGES.get(tiers.kind(agent), ())
    }
    expected.add((LOOP, WHOLE_LOOP))
    own = set(plan.tree.agents()) - set(plan.external) - {RECORDER}
    for port in ports(plan.tree):
        regular = port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
        if regular and port.publisher in own and own.intersection(listeners(port, plan.tree)):
            expected.add(("hop", port.signal.name))
    return expected


def _last_cycle(reader: RunReader, plan: RunPlan, *, interrupted: bool) -> int | None:
    """Return the last cycle that counts; None: all do.

    An external plant goes on after Ctrl-C, when the controllers have left it.
    """
    if not interrupted or PLANT not in plan.external:
        return None
    return last_cycle_with_all(reader, set(plan.tree.leaves) - set(plan.external))


def _hops_from(timings: Sequence[ProcessTiming], plan: RunPlan) -> Iterator[Times]:
    """Yield the hop latency of each signal of external agents, as their listeners measured it.

    What an external plant alone says has its row already.
    """
    measured: dict[tuple[str, str], list[tuple[ProcessTiming, str]]] = defaultdict(list)
    for port in ports(plan.tree):
        if port.publisher in plan.external and port.publisher != PLANT:
            name = f"hop/{port}"
            own = [(timing, name) for timing in timings if name in timing.histograms]
            measured[port.publisher, port.signal.name] += own
    for (agent, signal), parts in measured.items():
        hops = distribution_of(parts)
        if hops is not None:
            yield Times("hop", f"{signal} of {agent}", signal, hops)


def _responses(
    responses_ns: Mapping[tuple[str, str], Sequence[int]], plan: RunPlan
) -> Iterator[Times]:
    """Yield the rows of external agents, which the recording tells of them."""
    tiers = Tiers(plan.tree)

    def place(found: tuple[str, str]) -> tuple[str, int]:
        agent, stage = found
        return agent, STAGES[tiers.kind(agent)].index(stage)

    for agent, stage in sorted(responses_ns, key=place):
        times_ns = responses_ns[agent, stage]
        yield from _outside_rows("response", f"{agent} {stage}", tiers.kind(agent), times_ns)


def _outside_rows(measure: str, of: str, kind: str, times_ns: Sequence[int]) -> Iterator[Times]:
    """Yield the row of these durations, if there are any."""
    histogram = new_histogram()
    for time_ns in times_ns:
        record_ns(histogram, time_ns)
    found = distribution(histogram)
    if found is not None:
        yield Times(measure, of, kind, found, outside=True)


def _in_order(times: Sequence[Times]) -> tuple[Times, ...]:
    """Bring what was seen from outside to its place, measure by measure."""
    return tuple(sorted(times, key=lambda row: MEASURES.index(row.measure)))


def _process_times(accounts: Sequence[ProcessAccount], plan: RunPlan) -> tuple[ProcessTimes, ...]:
    tiers = Tiers(plan.tree)
    return tuple(
        ProcessTimes(
            agent=account.agent,
            tier=tiers.tier(account.agent),
            policy=timing.policy,
            cpu_percent=cpu_percent(timing),
            resident_mb=timing.resident_mb,
            switches_voluntary=timing.switches_voluntary,
            switches_involuntary=timing.switches_involuntary,
            missed_deadlines=timing.missed_deadlines,
            overruns=timing.overruns,
            missing_inputs=timing.missing_inputs,
            late_used=timing.late_used,
            cycles_given_up=account.cycles_given_up,
            dropped=account.dropped,
            times=times_of(timing, plan.tree),
        )
        for account in accounts
        if (timing := account.timing) is not None
    )


def _slow_cycle(cycle: CycleWaits) -> SlowCycle:
    slowest = cycle.slowest
    return SlowCycle(
        cycle.cycle,
        cycle.loop_ns / 1e3,
        slowest.agent,
        slowest.stage,
        slowest.length_ns / 1e3,
        cycle.in_words(),
    )
