"""Gathers what the processes of a run measured: by tier and signal, and process by process."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, TypeAlias

import msgspec

from agents.deadlines import stage_place
from agents.kinds import KINDS, kind_of
from agents.stopwatch import ProcessTiming
from bus_schemas.signals import SIGNALS
from bus_schemas.tree import ControlTree, depth
from launch_scripts.summary import ProcessAccount
from launch_scripts.timing.distributions import Distribution, distribution, merged, together

LOOP: Final = "loop"
EVERY_COMMAND: Final = "each command"
WHOLE_LOOP: Final = "all commands"

MEASURES: Final = (LOOP, "decision", "hop", "lateness", "jitter", "age", "response")
"""What is measured, in the order in which it is reported."""


_Own: TypeAlias = tuple[ProcessTiming, str]
"""A measure of a process: its account, and the measure's name."""


class Times(msgspec.Struct, frozen=True):
    """A row of durations.

    Attributes
    ----------
    measure
        One of `MEASURES`.
    of
        What was measured: a stage of a tier (`direct estimate`), a signal (`impp`).
    kind
        What its budget goes by where it is not `of`: the kind of the processes, or the signal.
    times
        The durations.
    outside
        Whether others measured it: a foreign device measures nothing of itself for us.
    """

    measure: str
    of: str
    kind: str
    times: Distribution
    outside: bool = False


class TierAccount(msgspec.Struct, frozen=True):
    """What the processes of one tier counted and took.

    Attributes
    ----------
    tier, kind
        Name of the tier (`supervisor 1` where there are several tiers of them), and its kind.
    processes
        How many processes measured themselves.
    missed_deadlines
        How often a stage's deadline passed before all its inputs had arrived.
    missing_inputs
        How many inputs had not arrived then.
    late_used
        How often a word of an earlier cycle stood in for one that was absent.
    dropped
        Messages that could not be used.
    overruns
        How often a stage closed late by the process's own fault, or not at all.
    cycles_given_up
        Cycles that a process gave up as a whole, since they were over before it came to them.
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
    late_used: int
    dropped: int
    overruns: int
    cycles_given_up: int
    cpu_percent: float
    cpu_highest_percent: float
    resident_mb: float


class Tiers:
    """The tiers of a plant's processes, by name.

    Parameters
    ----------
    tree
        Control tree.
    """

    def __init__(self, tree: ControlTree) -> None:
        self._tree = tree
        self._supervised = {depth(path) for path in tree.parents if path}

    def kind(self, agent: str) -> str:
        """Return `plant`, `central`, `supervisor`, `direct` or `recorder`."""
        return kind_of(agent, self._tree)

    def tier(self, agent: str) -> str:
        """Return the kind; supervisors of several tiers have a number, 1 below the centre."""
        kind = self.kind(agent)
        numbered = kind == "supervisor" and len(self._supervised) > 1
        return f"{kind} {depth(agent)}" if numbered else kind

    def order(self, agent: str, stage: str) -> tuple[int, str]:
        """Return what sorts stages of tiers into the order of a cycle."""
        return stage_place(agent, stage, self._tree), self.tier(agent)


def times_by_tier(timings: Sequence[ProcessTiming], tree: ControlTree) -> tuple[Times, ...]:
    """Merge the histograms of all processes: by tier and stage, hops by signal."""
    tiers = Tiers(tree)
    found: dict[tuple[str, str, str], list[_Own]] = defaultdict(list)
    place: dict[tuple[str, str, str], tuple[int, str]] = {}
    for timing in timings:
        for name in timing.histograms:
            measure, _, what = name.partition("/")
            key = _row_of(measure, what, timing.agent, tiers)
            found[key].append((timing, name))
            place[key] = _place(measure, what, timing.agent, tiers)
    keys = sorted(found, key=lambda key: (MEASURES.index(key[0]), place[key], key))
    return tuple(_rows((*key, found[key]) for key in keys))


def times_of(timing: ProcessTiming, tree: ControlTree) -> tuple[Times, ...]:
    """Return what one process measured, row by row, hops by port."""
    tiers = Tiers(tree)
    kind = tiers.kind(timing.agent)
    names = sorted(timing.histograms, key=lambda name: _place_of_own(name, timing.agent, tiers))
    return tuple(
        _rows(
            (name.partition("/")[0], name.partition("/")[2], kind, [(timing, name)])
            for name in names
        )
    )


def tier_accounts(accounts: Iterable[ProcessAccount], tree: ControlTree) -> tuple[TierAccount, ...]:
    """Add up what the processes of each tier counted and took.

    Those of which nothing was measured are left out. The recorder has no stages and counts nothing
    here, but takes its share of the processors.
    """
    tiers = Tiers(tree)
    by_tier: dict[str, list[ProcessAccount]] = defaultdict(list)
    for account in accounts:
        if account.timing is not None or account.cpu_percent is not None:
            by_tier[tiers.tier(account.agent)].append(account)
    found = [_tier_account(tier, members) for tier, members in by_tier.items()]
    return tuple(sorted(found, key=lambda entry: (KINDS.index(entry.kind), entry.tier)))


def cpu_percent(timing: ProcessTiming) -> float:
    """Return the processor time of a process [% of one core]."""
    return 100.0 * timing.cpu_s / timing.wall_s if timing.wall_s > 0.0 else 0.0


def _row_of(measure: str, what: str, agent: str, tiers: Tiers) -> tuple[str, str, str]:
    if measure == LOOP:
        return measure, EVERY_COMMAND if what else WHOLE_LOOP, ""
    if measure == "hop":
        return measure, what.rpartition("/")[2], ""
    return measure, f"{tiers.tier(agent)} {what}", tiers.kind(agent)


def _place(measure: str, what: str, agent: str, tiers: Tiers) -> tuple[int, str]:
    if measure == LOOP:
        return 1 if what else 0, ""
    if measure == "hop":
        return _place_of_signal(what), ""
    return tiers.order(agent, what)


def _place_of_own(name: str, agent: str, tiers: Tiers) -> tuple[int, tuple[int, str], str]:
    measure, _, what = name.partition("/")
    return MEASURES.index(measure), _place(measure, what, agent, tiers), what


def _place_of_signal(port: str) -> int:
    names = [signal.name for signal in SIGNALS]
    return names.index(port.rpartition("/")[2])


def _rows(entries: Iterable[tuple[str, str, str, list[_Own]]]) -> Iterator[Times]:
    for measure, of, kind, own in entries:
        found = distribution_of(own)
        if found is not None:
            yield Times(measure, of, kind, found)


def distribution_of(own: Sequence[_Own]) -> Distribution | None:
    """Return the figures of durations that several processes measured; None if there are none."""
    extremes = [timing.extremes[name] for timing, name in own if name in timing.extremes]
    histogram = merged(timing.histograms[name] for timing, name in own)
    return distribution(histogram, together(extremes) if len(extremes) == len(own) else None)


def _tier_account(tier: str, members: Sequence[ProcessAccount]) -> TierAccount:
    timings = [account.timing for account in members if account.timing is not None]
    shares = [_share_percent(account) for account in members]
    return TierAccount(
        tier=tier,
        kind=tier.partition(" ")[0],
        processes=len(members),
        missed_deadlines=sum(sum(timing.missed_deadlines.values()) for timing in timings),
        missing_inputs=sum(sum(timing.missing_inputs.values()) for timing in timings),
        late_used=sum(timing.late_used for timing in timings),
        dropped=sum(sum(account.dropped.values()) for account in members),
        overruns=sum(sum(timing.overruns.values()) for timing in timings),
        cycles_given_up=sum(account.cycles_given_up for account in members),
        cpu_percent=sum(shares),
        cpu_highest_percent=max(shares),
        resident_mb=max(_resident_mb(account) for account in members),
    )


def _share_percent(account: ProcessAccount) -> float:
    """Return its processor time: as it measured itself, or else as its launcher saw it."""
    if account.timing is not None:
        return cpu_percent(account.timing)
    return account.cpu_percent or 0.0


def _resident_mb(account: ProcessAccount) -> float:
    return account.resident_mb if account.timing is None else account.timing.resident_mb
