"""What the processes of each tier counted and took, as figures side by side."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple, TypeVar

import msgspec

from agents.cycle import KINDS, kind_of
from bus_schemas.tree import ControlTree
from launch_scripts.launcher.summary import ProcessAccount
from studies.timing.run_timing import AgentTiming, tier_of

N = TypeVar("N", int, float)

MISSING: Final = "-"
"""Stands for a figure that nobody knows any more."""


class TierAccount(msgspec.Struct, frozen=True):
    """What the processes of one tier came to.

    What only the launcher saw (dropped messages, processor time, memory) is None if its summary is
    not there.

    Attributes
    ----------
    tier, kind
        Name of the tier (`supervisor 1` where there are several tiers of them), and its kind.
    processes
        How many there were.
    missed_deadlines
        Stages that closed at their deadline without an input.
    missing_inputs
        How many inputs were not there then.
    old_inputs
        How often an older message was used in place of one.
    overruns
        Stages that had all inputs and spoke after their deadline.
    skipped_cycles
        Cycles in which a process published nothing.
    dropped
        Messages that could not be used.
    cpu_percent, cpu_highest_percent
        Processor time [% of one core]: of all of them, and of the one that took most.
    resident_mb
        Most memory of one of them [MB].
    """

    tier: str
    kind: str
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


def tier_accounts(
    agents: Mapping[str, AgentTiming],
    accounts: Iterable[ProcessAccount],
    wall_s: float,
    tree: ControlTree,
) -> tuple[TierAccount, ...]:
    """Add up what the processes of each tier came to.

    Parameters
    ----------
    agents
        What the recording tells of each agent.
    accounts
        What the launcher saw of each process: of the recorder too, which has no stages.
    wall_s
        How long the run took.
    tree
        Of the run.
    """
    seen = {account.agent: account for account in accounts}
    members: dict[str, list[str]] = defaultdict(list)
    for agent in dict.fromkeys((*agents, *seen)):
        members[tier_of(agent, tree)].append(agent)
    found = [
        _account(
            tier,
            [agents.get(name, AgentTiming()) for name in names],
            [seen[name] for name in names if name in seen],
            len(names),
            wall_s,
            kind_of(names[0], tree),
        )
        for tier, names in members.items()
    ]
    return tuple(sorted(found, key=lambda entry: (KINDS.index(entry.kind), entry.tier)))


def cpu_percent(account: ProcessAccount, wall_s: float) -> float | None:
    """Return the processor time of a process [% of one core]; None if it is not known."""
    if account.cpu_s is None or wall_s <= 0.0:
        return None
    return 100.0 * account.cpu_s / wall_s


def total(values: Iterable[N | None]) -> N | None:
    """Return the sum of what is known; None if nothing is."""
    known = [value for value in values if value is not None]
    return sum(known[1:], start=known[0]) if known else None


def _account(
    tier: str,
    timings: list[AgentTiming],
    accounts: list[ProcessAccount],
    processes: int,
    wall_s: float,
    kind: str,
) -> TierAccount:
    shares = [cpu_percent(account, wall_s) for account in accounts]
    return TierAccount(
        tier=tier,
        kind=kind,
        processes=processes,
        missed_deadlines=sum(timing.missed_deadlines.total() for timing in timings),
        missing_inputs=sum(timing.missing_inputs.total() for timing in timings),
        old_inputs=sum(timing.old_inputs for timing in timings),
        overruns=sum(timing.overruns.total() for timing in timings),
        skipped_cycles=sum(timing.skipped_cycles for timing in timings),
        dropped=total(sum(account.dropped.values()) for account in accounts),
        cpu_percent=total(shares),
        cpu_highest_percent=max((share for share in shares if share is not None), default=None),
        resident_mb=max((account.resident_mb for account in accounts), default=None),
    )


class TierColumn(NamedTuple):
    """A figure of a tier: its heading in two short lines, its width, and its text."""

    heading: str
    width: int
    text: Callable[[TierAccount], str]


def figure(value: float | None, decimals: int = 0) -> str:
    """Write a figure, or that it is missing."""
    return MISSING if value is None else f"{value:,.{decimals}f}"


TIER_COLUMNS: Final = (
    TierColumn("processes", 9, lambda tier: figure(tier.processes)),
    TierColumn("missed\ndeadlines", 9, lambda tier: figure(tier.missed_deadlines)),
    TierColumn("missing\ninputs", 7, lambda tier: figure(tier.missing_inputs)),
    TierColumn("old\ninputs", 7, lambda tier: figure(tier.old_inputs)),
    TierColumn("dropped", 7, lambda tier: figure(tier.dropped)),
    TierColumn("overruns", 8, lambda tier: figure(tier.overruns)),
    TierColumn("skipped\ncycles", 7, lambda tier: figure(tier.skipped_cycles)),
    TierColumn("CPU [%]\nall", 7, lambda tier: figure(tier.cpu_percent, 1)),
    TierColumn("CPU [%]\nhighest", 7, lambda tier: figure(tier.cpu_highest_percent, 1)),
    TierColumn("memory\n[MB]", 6, lambda tier: figure(tier.resident_mb, 1)),
)
"""What is told of each tier besides durations."""
