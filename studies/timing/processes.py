"""Counts and resources of each process of a run, and of each tier."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

import msgspec

from agents.cycle import KINDS, Kind, kind_of
from bus_schemas.tree import ControlTree
from launch_scripts.launcher.summary import ProcessAccount
from studies.timing.run_timing import AgentTiming, Times, tier_of

N = TypeVar("N", int, float)


class ProcessTiming(msgspec.Struct, frozen=True):
    """Counts and resources of one process; None where only its launcher knew and is not asked.

    Attributes
    ----------
    agent, tier, kind
        Its name, its tier (`supervisor 1` where there are several tiers of supervisors), its kind.
    missed_deadlines, overruns
        By stage. The recorder has none.
    missing_inputs
        By port.
    slowest_decision_us
        Its longest decision [us]; None for the recorder.
    dropped
        Messages that could not be used, by cause.
    cpu_percent
        Processor time [% of one core].
    resident_mb
        Most resident memory seen [MB].
    times
        Its own rows of durations; empty unless they were asked for.
    """

    agent: str
    tier: str
    kind: Kind
    missed_deadlines: dict[str, int]
    missing_inputs: dict[str, int]
    old_inputs: int
    overruns: dict[str, int]
    skipped_cycles: int
    slowest_decision_us: float | None
    dropped: dict[str, int] | None
    cpu_percent: float | None
    resident_mb: float | None
    times: tuple[Times, ...]


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


def process_timings(
    agents: Mapping[str, AgentTiming],
    accounts: Iterable[ProcessAccount],
    wall_s: float,
    tree: ControlTree,
) -> tuple[ProcessTiming, ...]:
    """Join what the recording and the launcher know of each process, the recorder included."""
    known = {account.agent: account for account in accounts}
    found = []
    for agent in dict.fromkeys((*agents, *known)):
        own, account = agents.get(agent), known.get(agent)
        timing = own or AgentTiming()
        found.append(
            ProcessTiming(
                agent=agent,
                tier=tier_of(agent, tree),
                kind=kind_of(agent, tree),
                missed_deadlines=dict(timing.missed_deadlines),
                missing_inputs=dict(timing.missing_inputs),
                old_inputs=timing.old_inputs,
                overruns=dict(timing.overruns),
                skipped_cycles=timing.skipped_cycles,
                slowest_decision_us=own.slowest_decision_ns / 1e3 if own else None,
                dropped=account.dropped if account else None,
                cpu_percent=_cpu_percent(account, wall_s),
                resident_mb=account.resident_mb if account else None,
                times=timing.times,
            )
        )
    return tuple(found)


def _cpu_percent(account: ProcessAccount | None, wall_s: float) -> float | None:
    if account is None or account.cpu_s is None or wall_s <= 0.0:
        return None
    return 100.0 * account.cpu_s / wall_s


def tier_timings(processes: Iterable[ProcessTiming]) -> tuple[TierTiming, ...]:
    """Add up the processes of each tier."""
    members: dict[str, list[ProcessTiming]] = {}
    for process in processes:
        members.setdefault(process.tier, []).append(process)
    found = map(_tier, members.values())
    return tuple(sorted(found, key=lambda tier: (KINDS.index(tier.kind), tier.tier)))


def _tier(members: Sequence[ProcessTiming]) -> TierTiming:
    shares = [one.cpu_percent for one in members if one.cpu_percent is not None]
    memory = [one.resident_mb for one in members if one.resident_mb is not None]
    return TierTiming(
        tier=members[0].tier,
        kind=members[0].kind,
        processes=len(members),
        missed_deadlines=sum(sum(one.missed_deadlines.values()) for one in members),
        missing_inputs=sum(sum(one.missing_inputs.values()) for one in members),
        old_inputs=sum(one.old_inputs for one in members),
        overruns=sum(sum(one.overruns.values()) for one in members),
        skipped_cycles=sum(one.skipped_cycles for one in members),
        dropped=total(
            None if one.dropped is None else sum(one.dropped.values()) for one in members
        ),
        cpu_percent=total(shares),
        cpu_highest_percent=max(shares, default=None),
        resident_mb=max(memory, default=None),
    )


def total(values: Iterable[N | None]) -> N | None:
    """Return the sum of the known values; None if none is known."""
    known = [value for value in values if value is not None]
    return sum(known[1:], start=known[0]) if known else None
