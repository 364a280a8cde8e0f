"""Counts and resources of each process of a run, and of each tier."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from agents.cycle import KINDS, Kind, kind_of
from bus_schemas.tree import ControlTree, depth
from launch_scripts.launcher.summary import ProcessAccount
from studies.timing.durations import Times

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
        name = account.agent
        bare = ProcessTiming(agent=name, tier=tier_of(name, tree), kind=kind_of(name, tree))
        found[name] = replace(
            found.get(name, bare),
            dropped=account.dropped,
            resident_mb=account.resident_mb,
            cpu_percent=None
            if account.cpu_s is None or wall_s <= 0.0
            else 100.0 * account.cpu_s / wall_s,
        )
    return tuple(found.values())


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
    dropped = [sum(one.dropped.values()) for one in members if one.dropped is not None]
    return TierTiming(
        tier=members[0].tier,
        kind=members[0].kind,
        processes=len(members),
        missed_deadlines=sum(sum(one.missed_deadlines.values()) for one in members),
        missing_inputs=sum(sum(one.missing_inputs.values()) for one in members),
        old_inputs=sum(one.old_inputs for one in members),
        overruns=sum(sum(one.overruns.values()) for one in members),
        skipped_cycles=sum(one.skipped_cycles for one in members),
        dropped=total(dropped),
        cpu_percent=total(shares),
        cpu_highest_percent=max(shares, default=None),
        resident_mb=max(memory, default=None),
    )


def total(values: Iterable[N | None]) -> N | None:
    """Return the sum of the known values; None if none is known."""
    known = [value for value in values if value is not None]
    return sum(known[1:], start=known[0]) if known else None
