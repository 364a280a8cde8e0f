"""A campaign: one plant, thousands of seeds, each with random faults on the virtual clock.

A seed and a scenario give the same faults and the same run on every machine. A seed that breaks an
invariant is shrunk to the shortest list of faults that still does.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.faults import FaultRule, links
from bus_schemas.tree import agent_name, depth
from launch_scripts.launcher.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from launch_scripts.launcher.supervision import RunFailure
from launch_scripts.scenarios.fault_rules import parse_fault
from launch_scripts.scenarios.preparation import Preparation
from sim_plant.profile import Profile
from studies.campaign.invariants import SETTLES_S, Trace, Violation, violations

MOST_FAULTS: Final = 5
FIRST_S: Final = 10.0
"""No fault begins before: estimates need some cycles."""

_LONGEST_S: Final = 40.0
"""How long a process stands still, or a network is bad, at most."""

_SETTLED_S: Final = 10.0
"""How long a run goes on once it must be as without faults."""


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one seed.

    rules: Its faults, as `--fault` reads them; the shortest list that breaks the first invariant.
    over_kwh, under_kwh: Energy beyond and below what the plant delivers without faults.
    over_kw, under_kw: The most of it in a cycle.
    """

    seed: int
    rules: tuple[str, ...]
    violations: tuple[Violation, ...]
    over_kwh: float
    under_kwh: float
    over_kw: float
    under_kw: float

    @property
    def fault_rules(self) -> tuple[FaultRule, ...]:
        return tuple(map(parse_fault, self.rules))


@dataclass(frozen=True, slots=True)
class Campaign:
    """A plant, and its power without faults, shape (cycles,)."""

    plan: RunPlan
    profile: Profile
    healthy_kw: NDArray[np.float64]


def campaign(preparation: Preparation) -> Campaign:
    plan = on_the_clock(preparation.plan)
    profile = preparation.profile
    return Campaign(plan, profile, trace_of(plan, profile, ()).delivered_kw)


def run_seed(campaign: Campaign, seed: int) -> Outcome:
    """Run one seed; shrink it if it breaks an invariant."""
    rules = random_rules(campaign.plan, seed)
    trace, broken = tried(campaign, rules)
    if broken:
        rules = _shrunk(campaign, rules, broken[0].invariant)
        trace, broken = tried(campaign, rules)
    apart_kw = trace.delivered_kw - campaign.healthy_kw[: len(trace.produced)]
    hours = campaign.plan.cycle_ns / 3.6e12
    return Outcome(
        seed=seed,
        rules=tuple(map(str, rules)),
        violations=tuple(broken),
        over_kwh=float(np.maximum(apart_kw, 0.0).sum() * hours),
        under_kwh=float(np.maximum(-apart_kw, 0.0).sum() * hours),
        over_kw=float(max(apart_kw.max(), 0.0)),
        under_kw=float(max(-apart_kw.min(), 0.0)),
    )


def judge(campaign: Campaign, rules: tuple[FaultRule, ...], trace: Trace) -> list[Violation]:
    """Return the invariants that a run under some faults breaks."""
    plan = campaign.plan
    # When all faults are over, and inverters have done what they were told.
    last_s = max(map(_end_s, rules)) + _slowest_s(plan)
    # Inverters that hear nothing more obey for the revert time. Where direct controllers live and
    # hear the plant, and somebody only divides on old reports, `hold_cycles` is the longest.
    hold_s = plan.hold_cycles * plan.cycle_ns / 1e9
    reverts = [plan.settings_of(leaf).revert for leaf in plan.tree.leaves]
    revert_s = max(last_s if revert is None else revert.after_s for revert in reverts)
    longest_s = hold_s + 3.0 if all(_is_above(plan, rule) for rule in rules) else revert_s + hold_s
    longest_s += _slowest_s(plan)
    healthy_kw = campaign.healthy_kw[: len(trace.produced)]
    return list(violations(plan, trace, healthy_kw, last_s, longest_s))


def tried(campaign: Campaign, rules: tuple[FaultRule, ...]) -> tuple[Trace, list[Violation]]:
    """Return a run under some faults, up to when it must have settled, and what it breaks."""
    plan = campaign.plan
    last_s = max(map(_end_s, rules)) + _settles_s(plan) + _SETTLED_S
    last = round(last_s * 1e9 / plan.cycle_ns)
    shorter = replace(plan, cycles=min(plan.cycles, last))
    trace = trace_of(shorter, campaign.profile, rules)
    return trace, judge(campaign, rules, trace)


def _slowest_s(plan: RunPlan) -> float:
    """Return how long the slowest inverter takes to obey [s]."""
    return max(map(plan.follows_within_s, plan.tree.leaves))


def least_length_s(plan: RunPlan) -> float:
    """Length of a run in which faults can come about and be over [s]."""
    return 2 * FIRST_S + _LONGEST_S + _settles_s(plan)


def _settles_s(plan: RunPlan) -> float:
    """Return the time after the last fault in which the plant becomes as without any [s]."""
    return SETTLES_S + plan.hold_cycles * plan.cycle_ns / 1e9 + _slowest_s(plan)


def random_rules(plan: RunPlan, seed: int) -> tuple[FaultRule, ...]:
    draw = random.Random(seed)
    length_s = plan.cycles * plan.cycle_ns / 1e9
    last_s = length_s - _settles_s(plan) - FIRST_S
    # The upper tiers are few and matter most: each tier is as likely as the others.
    tiers: dict[int, list[str]] = {}
    for node in plan.tree.nodes:
        tiers.setdefault(depth(node), []).append(agent_name(node))
    pairs = sorted({(port.publisher, listener) for port, listener in links(plan.tree)})
    found = []
    for _ in range(draw.randint(1, MOST_FAULTS)):
        begin_s = round(draw.uniform(FIRST_S, last_s - FIRST_S), 1)
        end_s = round(min(begin_s + draw.uniform(0.5, _LONGEST_S), last_s), 1)
        at = (begin_s, end_s)
        agent = draw.choice(draw.choice(list(tiers.values())))
        kind = draw.choice(["kill", "freeze", "partition", "network"])
        if kind == "kill":
            found.append(FaultRule(kill=agent, at=(begin_s,)))
        elif kind == "freeze":
            found.append(FaultRule(freeze=agent, at=at))
        elif kind == "partition":
            source, listener = draw.choice(pairs)
            found.append(FaultRule(partition=f"{source}|{listener}", at=at))
        else:
            found.append(_bad_network(draw, draw.choice(["*", agent]), at))
    return tuple(found)


def _bad_network(draw: random.Random, source: str, at: tuple[float, float]) -> FaultRule:
    return FaultRule(
        source=source,
        delay_ms=draw.choice([0.0, 20.0, 300.0, 3000.0]),
        jitter_ms=draw.choice([0.0, 50.0]),
        loss=draw.choice([0.02, 0.2, 0.5]),
        duplicate=draw.choice([0.0, 0.1]),
        at=at,
    )


def _end_s(rule: FaultRule) -> float:
    """When a rule and its effects are over [s]."""
    longest_s = (rule.delay_ms + rule.jitter_ms) / 1e3  # Jitter is uniform; nothing is reordered.
    return rule.at[-1] + (RESTART_TAKES_S if rule.kill is not None else longest_s)


def _is_above(plan: RunPlan, rule: FaultRule) -> bool:
    """Whether a rule leaves direct controllers, and what they and the plant say, alone."""
    inverters = set(plan.tree.leaves)
    if rule.stops is not None:
        return rule.stops not in inverters
    return rule.partition is not None and inverters.isdisjoint(rule.partition.split("|"))


def _shrunk(
    campaign: Campaign, rules: tuple[FaultRule, ...], invariant: str
) -> tuple[FaultRule, ...]:
    """Leave out one fault after the other, as long as the invariant still breaks."""
    for rule in rules:
        fewer = tuple(other for other in rules if other is not rule)
        if fewer and any(one.invariant == invariant for one in tried(campaign, fewer)[1]):
            rules = fewer
    return rules


def trace_of(
    plan: RunPlan,
    profile: Profile,
    rules: tuple[FaultRule, ...],
    restart_takes_s: float = RESTART_TAKES_S,
) -> Trace:
    """Return the messages of a run under some faults; a killed controller is away for so long."""
    trace = Trace()
    # A run without faults goes by the same clock: a rule of no length says so.
    idle = (FaultRule(loss=1.0, at=(1e9, 2e9)),)
    plan = replace(plan, faults=rules or idle)
    try:
        for _ in MemoryRun(plan, profile, trace, restart_takes_s).cycles():
            pass
    except RunFailure as failure:
        trace.ended = str(failure)
    return trace
