"""A campaign: one plant, thousands of seeds, each with random faults on the virtual clock.

A seed and a scenario give the same faults and the same run on every machine. A seed that breaks an
invariant is shrunk to the shortest list of faults that still does. Faults last for less or for
longer than each time-out of the system: hold, restart, revert.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.cycle import kind_of
from agents.faults import Fault, Freeze, Kill, ProcessFault, Trip, incidents
from agents.plan import RunPlan, changed
from bus_schemas.errors import FailureError, InputError
from bus_schemas.faults import Blackout, Disturbance, LinkFault, Partition, links
from bus_schemas.tree import PLANT, agent_name, depth, parent_of
from launch_scripts.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from scenarios.fault_rules import fault_text
from scenarios.preparation import Preparation
from sim_plant.profile import Profile
from studies.campaign.invariants import SETTLES_S, Violation, violations
from studies.campaign.trace import FaultyRun, Trace

_MOST_FAULTS: Final = 5
_FIRST_S: Final = 10.0
"""No fault begins before: estimates need some cycles."""

_APART_S: Final = 15.0
"""All faults of a seed begin within this time, so that they meet."""

_SETTLED_S: Final = 10.0
"""How long a run goes on once it must be as without faults."""

_OLD_REPORTS_S: Final = 3.0
"""How much longer than `hold_cycles` a parent may divide power by old reports."""

_MARGIN_S: Final = 10.0
"""How much longer or shorter than a time-out a fault lasts at most."""

_STOPPED_S: Final = 3.0
"""So long before and after a process stands still it may leave a cycle unfinished."""

_NEVER_S: Final = 1e6
"""When a process is there again that never is."""

_STANDBY_SHARE: Final = 0.25
"""Share of the seeds in which parents have a standby."""


class SeedResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one seed.

    rules: Its faults, as `--fault` reads them; the shortest list that breaks the first invariant.
    standby: Whether all parents had one.
    over_kwh, under_kwh: Energy beyond and below what the plant delivers without faults, under all
        faults that were drawn.
    over_kw, under_kw: The most of it in a cycle.
    """

    seed: int
    rules: tuple[str, ...]
    standby: bool
    violations: tuple[Violation, ...]
    over_kwh: float
    under_kwh: float
    over_kw: float
    under_kw: float


@dataclass(frozen=True, slots=True)
class Campaign:
    """A plant, its own faults among those of each seed, and its power without any [kW]."""

    plan: RunPlan
    profile: Profile
    healthy_kw: NDArray[np.float64]


def campaign(preparation: Preparation) -> Campaign:
    plan, profile = on_the_clock(preparation.plan), preparation.profile
    if plan.grid.moves_target:
        raise InputError("grid: expected no ramp limits or droop, which the invariants do not know")
    return Campaign(plan, profile, trace_of(plan, profile, ()).delivered_kw)


def run_seed(found: Campaign, seed: int) -> SeedResult:
    """Run one seed; shrink it if it breaks an invariant. Seed 0 draws no faults."""
    plan, own = found.plan, found.plan.faults.rules
    faults, standby = faults_of(plan, seed) if seed else ((), False)
    plan = with_standbys(plan, standby)
    trace, broken = judged_run(found, plan, own + faults)
    apart_kw = trace.delivered_kw - found.healthy_kw[: len(trace.produced)]
    for fault in faults if broken else ():
        fewer = tuple(other for other in faults if other is not fault)
        its = judged_run(found, plan, own + fewer)[1]
        if any(one.invariant == broken[0].invariant for one in its):
            faults, broken = fewer, its
    hours = plan.timing.cycle_ns / 3.6e12
    return SeedResult(
        seed=seed,
        rules=tuple(map(fault_text, faults)),
        standby=standby,
        violations=tuple(broken),
        over_kwh=float(np.maximum(apart_kw, 0.0).sum() * hours),
        under_kwh=float(np.maximum(-apart_kw, 0.0).sum() * hours),
        over_kw=float(max(apart_kw.max(), 0.0)),
        under_kw=float(max(-apart_kw.min(), 0.0)),
    )


def with_standbys(plan: RunPlan, standby: bool) -> RunPlan:
    parents = tuple(map(agent_name, plan.tree.parents))
    return changed(plan, supervision={"standby": parents}) if standby else plan


def trace_of(plan: RunPlan, profile: Profile, faults: Sequence[Fault]) -> Trace:
    """Return the messages of a run under some faults."""
    trace = Trace()
    # A run without faults goes by the same clock: a rule of no length says so.
    idle = Disturbance(loss=1.0, at=(1e9, 2e9))
    plan = changed(plan, faults={"rules": tuple(faults) or (idle,)})
    try:
        for _ in MemoryRun(plan, profile, trace).cycles():
            pass
    except FailureError as failure:
        trace.ended = str(failure)
    return trace


def judged_run(
    found: Campaign, plan: RunPlan, faults: Sequence[Fault]
) -> tuple[Trace, list[Violation]]:
    """Return a run under some faults, up to when it must have settled, and what it breaks."""
    cycle_s = plan.timing.cycle_s
    slowest_s = max(map(plan.site.follows_within_s, plan.tree.leaves))
    hold_s = plan.control.hold_cycles * cycle_s
    # When all faults are over, and inverters have obeyed the last commands.
    last_s = max((end_s(fault) for fault in faults), default=0.0) + slowest_s
    settled_s = last_s + SETTLES_S + hold_s if faults else 0.0
    cycles = min(settled_s + _SETTLED_S, 1e9) / cycle_s if faults else inf
    plan = changed(plan, timing={"cycles": round(min(plan.timing.cycles, cycles))})
    trace = trace_of(plan, found.profile, faults)
    # An inverter that hears nothing more obeys for the revert time. If direct controllers live and
    # hear the plant, only parents decide wrongly, on reports that are at most `hold_cycles` old.
    revert_s = max(plan.site.revert_of(leaf).after_s for leaf in plan.tree.leaves)
    spared = all(_spares_inverters(plan, fault) for fault in faults)
    longest_s = hold_s + slowest_s + (_OLD_REPORTS_S if spared else revert_s)
    first_s = min(map(begin_s, faults), default=inf)
    stopped: dict[str, list[range]] = {}
    for one in incidents(faults, plan.tree, plan.wiring):
        until_s = max(one.time_s, one.until_s) + _STOPPED_S
        cycles_of = range(int((one.time_s - _STOPPED_S) / cycle_s), int(until_s / cycle_s) + 1)
        stopped.setdefault(one.agent, []).append(cycles_of)
    quiet = (first_s / cycle_s, settled_s / cycle_s)
    healthy_kw = found.healthy_kw[: len(trace.produced)]
    frozen = [one for one in faults if isinstance(one, Freeze) and one.zombie]
    zombies = {one.agent for one in incidents(frozen, plan.tree, plan.wiring)}
    longest = round(longest_s / cycle_s)
    run = FaultyRun(plan, trace, healthy_kw, quiet, longest, stopped, zombies)
    return trace, list(violations(run))


def least_length_s(plan: RunPlan) -> float:
    """Length of a run in which the longest faults are over and the plant has settled [s]."""
    slowest_s = max(map(plan.site.follows_within_s, plan.tree.leaves))
    hold_s = plan.control.hold_cycles * plan.timing.cycle_s
    longest_s = max(_time_outs_s(plan)) + _MARGIN_S
    return _FIRST_S + _APART_S + longest_s + slowest_s + SETTLES_S + hold_s + _SETTLED_S


def _time_outs_s(plan: RunPlan) -> list[float]:
    """Return the times after which something changes: hold, restart, revert [s]."""
    return [
        RESTART_TAKES_S,
        plan.supervision.restart.frozen_s,
        plan.control.hold_cycles * plan.timing.cycle_s,
        *{plan.site.revert_of(leaf).after_s for leaf in plan.tree.leaves},
    ]


def faults_of(plan: RunPlan, seed: int) -> tuple[tuple[Fault, ...], bool]:
    """Return the random faults of a seed, and whether parents have standbys."""
    draw = random.Random(seed)
    standby = draw.random() < _STANDBY_SHARE
    # The upper tiers are few and matter most: each tier is as likely as the others.
    tiers: dict[int, list[str]] = {}
    for node in plan.tree.nodes:
        tiers.setdefault(depth(node), []).append(agent_name(node))
    focus = draw.choice(draw.choice(list(tiers.values())))
    faults: list[Fault] = []
    for _ in range(draw.randint(1, _MOST_FAULTS)):
        begin_s = round(draw.uniform(_FIRST_S, _FIRST_S + _APART_S), 1)
        lasts_s = draw.choice(_time_outs_s(plan)) + draw.uniform(-1.0, 1.0) * _MARGIN_S
        at = (begin_s, round(begin_s + max(lasts_s, 0.5), 1))
        agent = draw.choice([focus, draw.choice(draw.choice(list(tiers.values())))])
        if draw.random() < 0.5:
            faults += _process_faults(draw, plan, agent, at)
        else:
            faults.append(_link_fault(draw, plan, agent, at))
    return tuple(faults), standby


def _process_faults(
    draw: random.Random, plan: RunPlan, agent: str, at: tuple[float, float]
) -> Iterator[Fault]:
    begin_s, end_s = at
    agents = draw.choice([agent, agent, _beside(agent)])
    match draw.choice(["kill", "down", "freeze", "zombie", "trip"]):
        case "kill":
            yield Kill(agents, begin_s)
        case "down":
            yield Kill(agents, begin_s, draw.choice([end_s, end_s, _NEVER_S]))
        case "freeze":
            yield Freeze(agents, at)
        case "zombie":
            yield Freeze(agents, at, zombie=True)
            if draw.random() < 0.5:  # Its successor dies as well.
                yield Kill(agents, end_s, round(2.0 * end_s - begin_s, 1))
        case _:
            leaf = draw.choice(plan.tree.leaves)
            yield Trip(draw.choice([leaf, _beside(leaf)]), at)


def _link_fault(
    draw: random.Random, plan: RunPlan, agent: str, at: tuple[float, float]
) -> LinkFault:
    """Draw a fault of links, often those of an agent: each kind is as likely as the others."""
    kinds: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    any_agent = draw.random() < 0.5
    for port, listener in links(plan.tree):
        if not any_agent and agent not in {port.publisher, listener}:
            continue
        kind = kind_of(port.publisher, plan.tree), kind_of(listener, plan.tree), port.signal.name
        kinds.setdefault(kind, []).append((port.publisher, listener, port.signal.name))
    source, listener, signal = draw.choice(draw.choice(list(kinds.values())))
    sources, listeners = (draw.choice([end, _beside(end)]) for end in (source, listener))
    match draw.choice(["partition", "blackout", "deaf", "dumb", "network"]):
        case "partition":
            return Partition((sources, listeners), at)
        case "blackout":
            return Blackout(source=sources, listener=listeners, signal=signal, at=at)
        case "deaf":
            return Blackout(listener=listeners, at=at)
        case "dumb":
            return Blackout(source=sources, at=at)
    return _bad_network(draw, draw.choice(["*", sources]), at)


def _beside(agent: str) -> str:
    """Return a pattern for an agent and all its siblings."""
    return f"{parent_of(agent)}/*" if agent != PLANT and parent_of(agent) else "*"


def _bad_network(draw: random.Random, source: str, at: tuple[float, float]) -> Disturbance:
    return Disturbance(
        source=source,
        delay_ms=draw.choice([0.0, 20.0, 300.0, 3000.0]),
        jitter_ms=draw.choice([0.0, 50.0]),
        loss=draw.choice([0.02, 0.2, 0.5]),
        duplicate=draw.choice([0.0, 0.1]),
        reorder=(reorder := draw.choice([0.0, 0.2])),
        reorder_ms=3000.0 if reorder else None,
        at=at,
    )


def begin_s(fault: Fault) -> float:
    """Return when a fault begins [s]."""
    if isinstance(fault, Kill):
        return fault.at
    return fault.at[0] if fault.at else 0.0


def end_s(fault: Fault) -> float:
    """Return when a fault and its effects on processes and links are over [s]."""
    if isinstance(fault, Kill):
        return (fault.until or fault.at) + RESTART_TAKES_S
    if fault.at is None:
        return inf
    if isinstance(fault, Disturbance):  # Jitter may be that much, and be doubled.
        return fault.at[1] + (fault.delay_ms + 2.0 * fault.jitter_ms + fault.held_back_ms) / 1e3
    return fault.at[1] + (RESTART_TAKES_S if isinstance(fault, ProcessFault) else 0.0)


def _spares_inverters(plan: RunPlan, fault: Fault) -> bool:
    """Whether a fault leaves direct controllers alone, and all that they and the plant publish."""
    inverters = set(plan.tree.leaves)
    match fault:
        case Kill() | Freeze():
            stopped = incidents((fault,), plan.tree, plan.wiring)
            return inverters.isdisjoint(one.agent for one in stopped)
        case Partition(between=agents):
            return inverters.isdisjoint(agents) and not any("*" in agent for agent in agents)
    return False
