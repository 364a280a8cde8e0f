"""A campaign: one plant, thousands of seeds, each with random faults on the virtual clock.

A seed and a scenario give the same faults and the same run on every machine. A seed that breaks an
invariant is shrunk to the shortest list of faults that still does.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.faults import Fault, Freeze, Kill
from agents.plan import RunPlan, changed
from agents.team import Controller, controller
from bus_schemas.faults import Disturbance, Partition, links
from bus_schemas.tree import agent_name, depth
from launch_scripts.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from launch_scripts.supervision import RunFailure
from scenarios.fault_rules import fault_text, parse_fault
from scenarios.preparation import Preparation
from sim_plant.profile import Profile
from studies.campaign.invariants import SETTLES_S, FaultyRun, Trace, Violation, violations

_MOST_FAULTS: Final = 5
_FIRST_S: Final = 10.0
"""No fault begins before: estimates need some cycles."""

_LONGEST_S: Final = 40.0
"""How long a process stands still, or a network is bad, at most."""

_SETTLED_S: Final = 10.0
"""How long a run goes on once it must be as without faults."""

_OLD_REPORTS_S: Final = 3.0
"""How much longer than `hold_cycles` a parent may divide power by old reports."""


class SeedResult(msgspec.Struct, frozen=True, kw_only=True):
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
    def faults(self) -> tuple[Fault, ...]:
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


def run_seed(campaign: Campaign, seed: int) -> SeedResult:
    """Run one seed; shrink it if it breaks an invariant."""
    faults = faults_of(campaign.plan, seed)
    trace, broken = judged_run(campaign, faults)
    if broken:
        faults = _shrunk(campaign, faults, broken[0].invariant)
        trace, broken = judged_run(campaign, faults)
    apart_kw = trace.delivered_kw - campaign.healthy_kw[: len(trace.produced)]
    hours = campaign.plan.timing.cycle_ns / 3.6e12
    return SeedResult(
        seed=seed,
        rules=tuple(map(fault_text, faults)),
        violations=tuple(broken),
        over_kwh=float(np.maximum(apart_kw, 0.0).sum() * hours),
        under_kwh=float(np.maximum(-apart_kw, 0.0).sum() * hours),
        over_kw=float(max(apart_kw.max(), 0.0)),
        under_kw=float(max(-apart_kw.min(), 0.0)),
    )


def least_length_s(plan: RunPlan) -> float:
    """Length of a run in which faults can come about and be over [s]."""
    return 2 * _FIRST_S + _LONGEST_S + _settles_s(plan)


def judged_run(campaign: Campaign, faults: Sequence[Fault]) -> tuple[Trace, list[Violation]]:
    """Return a run under some faults, up to when it must have settled, and what it breaks."""
    plan = campaign.plan
    last_s = max(map(end_s, faults)) + _settles_s(plan) + _SETTLED_S
    last = round(last_s * 1e9 / plan.timing.cycle_ns)
    shorter = changed(plan, timing={"cycles": min(plan.timing.cycles, last)})
    trace = trace_of(shorter, campaign.profile, faults)
    return trace, judge(campaign, faults, trace)


def judge(campaign: Campaign, faults: Sequence[Fault], trace: Trace) -> list[Violation]:
    """Return the invariants that a run under some faults breaks."""
    plan = campaign.plan
    # When all faults are over, and inverters have obeyed the last commands.
    last_s = max(map(end_s, faults)) + _slowest_s(plan)
    # An inverter that hears nothing more obeys for the revert time. If direct controllers live and
    # hear the plant, only parents decide wrongly, on reports that are at most `hold_cycles` old.
    reverts = [plan.site.settings_of(leaf).revert for leaf in plan.tree.leaves]
    revert_s = max(last_s if revert is None else revert.after_s for revert in reverts)
    spared = all(spares_inverters(plan, fault) for fault in faults)
    longest_s = _hold_s(plan) + (_OLD_REPORTS_S if spared else revert_s) + _slowest_s(plan)
    healthy_kw = campaign.healthy_kw[: len(trace.produced)]
    return list(violations(FaultyRun(plan, trace, healthy_kw, last_s, longest_s)))


def trace_of(
    plan: RunPlan,
    profile: Profile,
    faults: Sequence[Fault],
    restart_takes_s: float = RESTART_TAKES_S,
    make: Callable[[RunPlan, str], Controller] = controller,
) -> Trace:
    """Return the messages of a run under some faults; see `MemoryRun`."""
    trace = Trace()
    # A run without faults goes by the same clock: a rule of no length says so.
    idle = Disturbance(loss=1.0, at=(1e9, 2e9))
    plan = changed(plan, faults={"rules": tuple(faults) or (idle,)})
    try:
        for _ in MemoryRun(plan, profile, trace, restart_takes_s, make).cycles():
            pass
    except RunFailure as failure:
        trace.ended = str(failure)
    return trace


def _shrunk(campaign: Campaign, faults: tuple[Fault, ...], invariant: str) -> tuple[Fault, ...]:
    """Leave out one fault after the other, as long as the invariant still breaks."""
    for fault in faults:
        fewer = tuple(other for other in faults if other is not fault)
        if fewer and any(one.invariant == invariant for one in judged_run(campaign, fewer)[1]):
            faults = fewer
    return faults


def _slowest_s(plan: RunPlan) -> float:
    """Return how long the slowest inverter takes to obey [s]."""
    return max(map(plan.site.follows_within_s, plan.tree.leaves))


def _hold_s(plan: RunPlan) -> float:
    return plan.control.hold_cycles * plan.timing.cycle_ns / 1e9


def _settles_s(plan: RunPlan) -> float:
    """Return the time after the last fault in which the plant becomes as without any [s]."""
    return SETTLES_S + _hold_s(plan) + _slowest_s(plan)


def faults_of(plan: RunPlan, seed: int) -> tuple[Fault, ...]:
    """Return the random faults of a seed. The run goes on until it must have settled after them."""
    draw = random.Random(seed)
    last_s = plan.timing.cycles * plan.timing.cycle_ns / 1e9 - _settles_s(plan) - _FIRST_S
    # The upper tiers are few and matter most: each tier is as likely as the others.
    tiers: dict[int, list[str]] = {}
    for node in plan.tree.nodes:
        tiers.setdefault(depth(node), []).append(agent_name(node))
    pairs = sorted({(port.publisher, listener) for port, listener in links(plan.tree)})
    faults: list[Fault] = []
    for _ in range(draw.randint(1, _MOST_FAULTS)):
        begin_s = round(draw.uniform(_FIRST_S, last_s - _FIRST_S), 1)
        end_s = round(min(begin_s + draw.uniform(0.5, _LONGEST_S), last_s), 1)
        at = (begin_s, end_s)
        agent = draw.choice(draw.choice(list(tiers.values())))
        match draw.choice(["kill", "freeze", "partition", "network"]):
            case "kill":
                faults.append(Kill(agent, begin_s))
            case "freeze":
                faults.append(Freeze(agent, at))
            case "partition":
                faults.append(Partition(draw.choice(pairs), at))
            case _:
                faults.append(_bad_network(draw, draw.choice(["*", agent]), at))
    return tuple(faults)


def _bad_network(draw: random.Random, source: str, at: tuple[float, float]) -> Disturbance:
    return Disturbance(
        source=source,
        delay_ms=draw.choice([0.0, 20.0, 300.0, 3000.0]),
        jitter_ms=draw.choice([0.0, 50.0]),
        loss=draw.choice([0.02, 0.2, 0.5]),
        duplicate=draw.choice([0.0, 0.1]),
        at=at,
    )


def end_s(fault: Fault) -> float:
    """Return when a fault and its effects on processes and links are over [s]."""
    match fault:
        case Kill(at=at_s):
            return at_s + RESTART_TAKES_S
        case Disturbance(at=(_, end_s)):  # Jitter is uniform; nothing is reordered.
            return end_s + (fault.delay_ms + fault.jitter_ms) / 1e3
        case Freeze(at=(_, end_s)) | Partition(at=(_, end_s)):
            return end_s
    raise ValueError(f"a campaign draws no {fault}")


def spares_inverters(plan: RunPlan, fault: Fault) -> bool:
    """Whether a fault leaves direct controllers alone, and all that they and the plant publish."""
    inverters = set(plan.tree.leaves)
    match fault:
        case Kill(agents=agent) | Freeze(agents=agent):
            return agent not in inverters
        case Partition(between=agents):
            return inverters.isdisjoint(agents)
    return False
