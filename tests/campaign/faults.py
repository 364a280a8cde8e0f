"""Random faults of a seed: those that a rule can state, and those that only a test can do."""

from __future__ import annotations

import random
from collections.abc import Iterator
from functools import partial
from math import inf
from typing import Final, NamedTuple, TypeAlias

from memory_runs import add_zombie

from agents.faults import Fault, Freeze, Kill, Trip
from agents.plan import RunPlan
from bus_schemas.faults import Blackout, Disturbance, LinkFault, Partition, links
from bus_schemas.tree import PLANT, agent_name, parent_of
from launch_scripts.simulation import RESTART_TAKES_S, MemoryRun

MOST_FAULTS: Final = 5
FIRST_CYCLES: Final = 10.0
"""No fault begins before: estimates need some cycles."""

APART_CYCLES: Final = 15.0
"""All faults of a seed begin within this time, so that they meet."""

MARGIN_CYCLES: Final = 10.0
"""How much longer or shorter than a time-out a fault lasts at most."""


class Down(NamedTuple):
    """A controller is killed, and its successor is there only after a while, or never."""

    agent: str
    at: tuple[float, float]

    def plan_in(self, run: MemoryRun) -> None:
        run.at(self.at[0], partial(run.remove, self.agent))
        if self.at[1] < inf:
            run.at(self.at[1], partial(run.start, self.agent))


class Zombie(NamedTuple):
    """A controller is replaced while it stands still, and wakes up beside its successor.

    successor_until: When the next one is there, if the successor dies in that moment.
    """

    agent: str
    at: tuple[float, float]
    successor_until: float = 0.0

    def plan_in(self, run: MemoryRun) -> None:
        add_zombie(run, self.agent, *self.at)
        if self.successor_until and self.agent in run.driver.loops:
            run.at(self.at[1], partial(run.remove, self.agent))
            run.at(self.successor_until, partial(run.start, self.agent))


class Stall(NamedTuple):
    """The plant's process stands still: it misses cycles, its inverters do not."""

    at: tuple[float, float]
    agent: str = PLANT

    def plan_in(self, run: MemoryRun) -> None:
        def freeze() -> None:
            plant = run.driver.leave(PLANT)
            run.bus.hold(PLANT, keep=True)

            def thaw() -> None:
                run.bus.release(PLANT)
                run.driver.join(plant)

            run.at(self.at[1], thaw)

        run.at(self.at[0], freeze)


OfTests: TypeAlias = Down | Zombie | Stall
AnyFault: TypeAlias = Fault | OfTests


def time_outs_s(plan: RunPlan) -> list[float]:
    """Return the times after which something changes: hold, restart, revert [s]."""
    hold_s = plan.control.hold_cycles * plan.timing.cycle_s
    reverts_s = {plan.site.revert_of(leaf).after_s for leaf in plan.tree.leaves}
    return [RESTART_TAKES_S, plan.supervision.restart.frozen_s, hold_s, *sorted(reverts_s)]


def faults_of(plan: RunPlan, seed: int) -> tuple[AnyFault, ...]:
    """Return the random faults of a seed: for less and for longer than each time-out."""
    draw, cycle_s = random.Random(seed), plan.timing.cycle_s
    # The upper tiers are few and matter most: each tier is as likely as the others.
    tiers: dict[int, list[str]] = {}
    for node in plan.tree.nodes:
        tiers.setdefault(node.count("/") + bool(node), []).append(agent_name(node))
    focus = draw.choice(draw.choice(list(tiers.values())))
    faults: list[AnyFault] = []
    for _ in range(draw.randint(1, MOST_FAULTS)):
        begin_s = round(draw.uniform(FIRST_CYCLES, FIRST_CYCLES + APART_CYCLES) * cycle_s, 3)
        lasts_s = draw.choice(time_outs_s(plan)) + draw.uniform(-1, 1) * MARGIN_CYCLES * cycle_s
        at = (begin_s, round(begin_s + max(lasts_s, 0.5 * cycle_s), 3))
        agent = draw.choice([focus, draw.choice(draw.choice(list(tiers.values())))])
        kinds = _process_faults if draw.random() < 0.55 else _link_fault
        faults += kinds(draw, plan, agent, at)
    return _fitting(faults)


def _fitting(faults: list[AnyFault]) -> tuple[AnyFault, ...]:
    """Leave out what would happen to a process that a test has already taken out."""
    taken: set[str] = set()
    found: list[AnyFault] = []
    for fault in faults:
        if isinstance(fault, Down | Zombie | Stall):
            if fault.agent in taken or any(isinstance(one, Kill | Freeze) for one in found):
                continue
            taken.add(fault.agent)
        if isinstance(fault, Kill | Freeze) and taken - {PLANT}:
            continue
        found.append(fault)
    return tuple(found)


def _process_faults(
    draw: random.Random, plan: RunPlan, agent: str, at: tuple[float, float]
) -> Iterator[AnyFault]:
    begin_s, end_s = at
    several = draw.choice([agent, agent, beside(agent)])
    match draw.choice(["kill", "storm", "down", "freeze", "zombie", "trip", "stall"]):
        case "kill":
            yield Kill(several, begin_s)
        case "storm":  # Killed again and again, as often as it is started again, or more often.
            within_s = plan.supervision.restart.within_s
            apart_s = max(draw.choice([2.0, 0.7 * min(within_s, 20.0)]), 2.0 * plan.timing.cycle_s)
            yield from (
                Kill(agent, round(begin_s + n * apart_s, 3)) for n in range(draw.choice([2, 4]))
            )
        case "down":
            yield Down(agent, (begin_s, draw.choice([end_s, end_s, inf])))
        case "freeze":
            yield Freeze(several, at)
        case "zombie":
            also_s = draw.choice([0.0, round(2.0 * end_s - begin_s, 3)])
            yield Zombie(agent, (begin_s, end_s), also_s if end_s - begin_s > 2.0 else 0.0)
        case "stall":
            # Also for longer than it makes up for: it then skips cycles.
            yield Stall((begin_s, min(end_s, begin_s + 30.0 * plan.timing.cycle_s)))
        case _:
            leaf = draw.choice(plan.tree.leaves)
            yield Trip(draw.choice([leaf, beside(leaf)]), at)


def _link_fault(
    draw: random.Random, plan: RunPlan, agent: str, at: tuple[float, float]
) -> Iterator[LinkFault]:
    """Draw a fault of links, often those of an agent: each kind is as likely as the others."""
    kinds: dict[tuple[int, int, str], list[tuple[str, str, str]]] = {}
    any_agent = draw.random() < 0.5
    for port, listener in links(plan.tree):
        if any_agent or agent in {port.publisher, listener}:
            kind = port.publisher.count("/"), listener.count("/"), port.signal.name
            found = kinds.setdefault(kind, [])
            found.append((port.publisher, listener, port.signal.name))
    source, listener, signal = draw.choice(draw.choice(list(kinds.values())))
    sources, listeners = (draw.choice([end, beside(end)]) for end in (source, listener))
    match draw.choice(["partition", "blackout", "deaf", "dumb", "network"]):
        case "partition":
            yield Partition((sources, listeners), at)
        case "blackout":
            yield Blackout(source=sources, listener=listeners, signal=signal, at=at)
        case "deaf":
            yield Blackout(listener=listeners, at=at)
        case "dumb":
            yield Blackout(source=sources, at=at)
        case _:
            yield _bad_network(draw, plan, draw.choice(["*", sources]), at)


def beside(agent: str) -> str:
    """Return a pattern for an agent and all its siblings."""
    return f"{parent_of(agent)}/*" if agent != PLANT and parent_of(agent) else "*"


def _bad_network(
    draw: random.Random, plan: RunPlan, source: str, at: tuple[float, float]
) -> Disturbance:
    cycle_ms = plan.timing.cycle_s * 1e3
    return Disturbance(
        source=source,
        delay_ms=draw.choice([0.0, 0.02, 0.3, 3.0]) * cycle_ms,
        jitter_ms=draw.choice([0.0, 0.05]) * cycle_ms,
        loss=draw.choice([0.02, 0.2, 0.5]),
        duplicate=draw.choice([0.0, 0.1]),
        reorder=(reorder := draw.choice([0.0, 0.2])),
        reorder_ms=3.0 * cycle_ms if reorder else None,
        at=at,
    )


def begin_s(fault: AnyFault) -> float:
    if isinstance(fault, Kill):
        return fault.at
    return fault.at[0] if fault.at else 0.0


def end_s(fault: AnyFault) -> float:
    """Return when a fault and its effects on processes and links are over [s]."""
    if isinstance(fault, Kill):
        return fault.at
    if isinstance(fault, Zombie):
        return max(fault.at[1], fault.successor_until)
    if fault.at is None:
        return inf
    if isinstance(fault, Disturbance):  # Jitter may be that much, and be doubled.
        return fault.at[1] + (fault.delay_ms + 2.0 * fault.jitter_ms + fault.held_back_ms) / 1e3
    return fault.at[1]
