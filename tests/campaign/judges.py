"""What must hold in every cycle of every run, whatever is killed, frozen, cut off or lost.

A run is judged by its messages alone. Nothing here, in `plant_judges` or in `control_judges` is
imported from the code that is judged: a page of formulas stands beside it instead. To add a judge,
write it, enter it into `JUDGES`, and plant a bug that it must find (`planted_bugs.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import control_judges
import numpy as np
import plant_judges
from numpy.typing import NDArray
from plant_judges import Breaches, fed_in_kw, true_mpp_kw
from run_trace import FaultyRun, key

from bus_schemas.tree import CENTRAL, PLANT, ROOT, agent_name

OUT_SHARE: Final = 0.05
"""Share of the rating by which a plant may deliver more than its dispatch, indefinitely, or
less than its inverters would, each by itself."""

SETTLED_SHARE: Final = 0.01
"""Share of the rating to which it is as without faults, once it has settled."""

USED_SHARE: Final = 0.9
"""Share of the cycle that is divided among its stages: one part for each, and one more for each
tier to the first."""

RETURNS_WITHIN: Final = 1
"""Cycles after its return in which a process must speak."""


class Violation(NamedTuple):
    """A judge's name, the first cycle in which what it checks does not hold, and how."""

    judge: str
    cycle: int
    text: str


def violations(run: FaultyRun) -> Iterator[Violation]:
    if run.trace.ended:
        yield Violation("end", len(run.trace.produced), run.trace.ended)
        return
    for name, judge in JUDGES.items():
        for cycle, text in sorted(judge(run))[:1]:
            yield Violation(name, cycle, text)


def _lasting(run: FaultyRun, beyond_kw: NDArray[np.float64]) -> Breaches:
    """Check that no power is above a share of the rating for longer than the faults allow."""
    since, cycles = 0, run.trace.cycles.tolist()
    for cycle, kw in zip(cycles, beyond_kw.tolist(), strict=True):
        if kw <= OUT_SHARE * run.rating_kw():
            since = cycle + 1
        elif cycle - since >= run.longest:
            yield since, f"{kw:,.0f} kW beyond what is due, for more than {run.longest} cycles"


def _desired_kw(run: FaultyRun) -> NDArray[np.float64]:
    """Return what the plant is to give at its meter in each cycle, whatever the sky does [kW]."""
    kw = np.array([one.dispatch_kw for one in run.trace.produced], dtype=np.float64)
    return np.minimum(np.maximum(kw, 0.0), run.rating_kw())


def over_delivery(run: FaultyRun) -> Breaches:
    """Check that the plant does not deliver more than its dispatch."""
    if not run.plan.grid.moves_target:
        yield from _lasting(run, run.trace.delivered_kw - _desired_kw(run))


def under_delivery(run: FaultyRun) -> Breaches:
    """Check that it does not deliver less than all inverters would if each acted by itself."""
    leaves = run.plan.tree.leaves
    ratings_kw = np.array([run.sharing_kw(leaf) for leaf in leaves])
    mpp_kw = np.array([true_mpp_kw(run, cycle) for cycle in run.trace.cycles])
    shares_kw = np.outer(_desired_kw(run), ratings_kw / ratings_kw.sum())
    alone_kw = fed_in_kw(run, np.minimum(mpp_kw, shares_kw))
    if not run.plan.grid.moves_target:
        yield from _lasting(run, alone_kw - run.trace.delivered_kw)


def recovery(run: FaultyRun) -> Breaches:
    """Check that some time after the last fault all is as if there had been none.

    Offers remember what was kept, and storages what they gave.
    """
    if run.healthy is None or run.plan.control.offers or run.plan.storages:
        return
    cycles = run.trace.cycles
    apart_kw = np.abs(run.trace.delivered_kw - run.healthy.trace.delivered_kw[cycles])
    for place in np.flatnonzero(apart_kw > SETTLED_SHARE * run.rating_kw()).tolist():
        if run.is_quiet(cycles[place]):
            text = f"{apart_kw[place]:,.0f} kW apart from the run without faults"
            yield int(cycles[place]), text


def inputs(run: FaultyRun) -> Breaches:
    """Check that inputs were sent, have not expired, come in order, and of no replaced process.

    Without a fault none is missing.
    """
    assert run.decisions
    yield from run.wrong_inputs


def one_authority(run: FaultyRun) -> Breaches:
    """Check that a process sends one message on a key in a cycle.

    In the end there is one process for each key, but for those that woke up hearing nobody.
    """
    yield from run.trace.twice
    for agent in ("plant", *map(agent_name, run.plan.tree.nodes)):
        if agent in run.zombies:
            continue
        for port, of in run.trace.of.items():
            if agent == _publisher(port):
                for cycle in filter(run.is_quiet, of):
                    if len(of[cycle]) > 1:
                        yield cycle, f"{len(of[cycle])} processes send {port}"


def _publisher(port: str) -> str:
    node, _, signal = port.rpartition("/")
    if signal in {"telemetry", "dispatch", "meter", "production"}:
        return PLANT
    if signal == "setpoint":
        node = node.rpartition("/")[0]
    return agent_name(node)


def silence(run: FaultyRun) -> Breaches:
    """Check that who lives and knows its share acts; without a fault everybody always speaks."""
    last, measured = run.trace.cycles[-1], set[tuple[str, int]]()
    spoke = {(one.agent, one.cycle, one.stage) for one in run.decisions}
    for one in run.decisions:
        if one.stage == "estimate" and one.used[key(one.node, "telemetry")] is not None:
            measured.add((one.agent, one.process))
        if one.cycle == last or run.is_stopped(one.agent, one.cycle):
            continue
        if one.stage == "apply" or one.used["dispatch"] is None:
            continue
        is_due = (one.agent, one.process) in measured or one.stage != "estimate"
        then = "actuate" if one.stage in {"estimate", "actuate"} else "solve"
        acts = (one.agent, one.cycle, then) in spoke
        if one.agent == CENTRAL:
            acts = key(run.plan.tree.children(ROOT)[0], "setpoint") in one.sent
        if is_due and not acts and (then == "actuate" or run.acts(one.node, one.cycle)):
            yield one.cycle, f"{one.agent} does not act, though it knows its share"
    spoken = {(agent, cycle) for agent, cycle, _ in spoke}
    for cycle in filter(run.is_quiet, range(last)):
        for node in run.plan.tree.nodes:
            if (agent_name(node), cycle) not in spoken and (node or run.acts(node, cycle)):
                yield cycle, f"{agent_name(node)} says nothing"


def returns(run: FaultyRun) -> Breaches:
    """Check that who was killed or has stood still is back as soon as the restart policy says."""
    spoke = {(one.agent, one.cycle) for one in run.decisions}
    last = int(run.trace.cycles[-1])
    for agent, cycles in run.returns.items():
        period = run.plan.control.period_cycles[0] if agent == CENTRAL else 1
        for away in run.away.get(agent, ()):
            early = [cycle for cycle in away if (agent, cycle) in spoke]
            yield from ((cycle, f"{agent} is back too early") for cycle in early[:1])
        for begin in cycles:
            within = range(begin, begin + RETURNS_WITHIN + period)
            if within[-1] < last and not any((agent, cycle) in spoke for cycle in within):
                yield begin, f"{agent} is not back"


def timely(run: FaultyRun) -> Breaches:
    """Check that each message is sent by its stage's deadline: its place in the cycle."""
    wall_ns, height = run.plan.timing.cycle_wall_ns, run.plan.tree.height
    if PLANT in run.stopped:
        return
    for one in run.decisions:
        level = one.node.count("/") + 1 if one.node else 0
        place = {
            "estimate": 1,
            "report": 1 + height - level,
            "solve": 1 + height + level,
            "actuate": 1 + height + level,
            "apply": 2 + 2 * height,
        }[one.stage]
        due_ns = wall_ns * (one.cycle + USED_SHARE * (place + height) / (2 + 3 * height))
        # One that returns, or joins by a dispatch that was long on its way, may be late for its
        # stages, but leaves out what is over.
        if run.is_stopped(one.agent, one.cycle) or 0 < one.process == one.cycle:
            due_ns = wall_ns * (one.cycle + 1)
        for port, message in one.sent.items():
            if message.publish_time_ns > due_ns + 1e3:
                late_s = (message.publish_time_ns - due_ns) / 1e9
                yield one.cycle, f"{port} is sent {late_s:.3f} s after its deadline"
            if message.ready_time_ns < one.cycle * wall_ns:
                yield one.cycle, f"{port} is decided before its cycle begins"


JUDGES: Final[dict[str, Callable[[FaultyRun], Breaches]]] = {
    "schedule": plant_judges.schedule,
    "inverters": plant_judges.inverters,
    "meters": plant_judges.meters,
    "storages": plant_judges.storages,
    "export": plant_judges.export,
    "inputs": inputs,
    "estimates": control_judges.estimates,
    "reports": control_judges.reports,
    "division": control_judges.division,
    "storage": control_judges.storages,
    "commands": control_judges.commands,
    "target": control_judges.target,
    "memory": plant_judges.memory,
    "offers": control_judges.offers,
    "one authority": one_authority,
    "silence": silence,
    "returns": returns,
    "timely": timely,
    "over-delivery": over_delivery,
    "under-delivery": under_delivery,
    "recovery": recovery,
}


class Worth(NamedTuple):
    """What a run without faults was worth, as shares of what was asked for, or of the rating.

    short: Missing energy that the sky would have given.
    over: Energy beyond what was asked for.
    apart: Mean distance from what was asked for, where the sky gives more.
    kept: Share of the intervals, if there are offers, of which at most 1 % was missing.
    promised: What was asked for, as a share of what the sky gave.
    """

    short: float
    over: float
    apart: float
    kept: float
    promised: float


def worth(run: FaultyRun) -> Worth:
    """Judge a run without faults absolutely: what all runs of the same wrong code share shows."""
    asked_kw, delivered_kw = _desired_kw(run), run.trace.delivered_kw
    if run.plan.grid.moves_target:
        asked_kw = np.array([*_aimed_kw(run)])
    mpp_kw = np.array([true_mpp_kw(run, k) for k in run.trace.cycles])
    possible_kw = fed_in_kw(run, mpp_kw, most=1.0)
    due_kw = np.minimum(asked_kw, possible_kw)
    enough = possible_kw > 1.05 * asked_kw
    short = np.maximum(due_kw - delivered_kw, 0.0).sum() / due_kw.sum()
    over = np.maximum(delivered_kw - asked_kw, 0.0).sum() / due_kw.sum()
    apart = np.abs(delivered_kw - asked_kw)[enough].mean() / run.rating_kw()
    kept = 1.0
    if run.plan.control.offers:
        length = round(run.plan.control.offers.interval_s / run.plan.timing.cycle_s)
        whole = len(asked_kw) // length * length
        asked, got = asked_kw[:whole].reshape(-1, length), delivered_kw[:whole].reshape(-1, length)
        missed = np.maximum(asked - got, 0.0).sum(axis=1) > 0.01 * asked.sum(axis=1)
        kept = float(1.0 - missed.mean())
    promised = float(asked_kw.sum() / possible_kw.sum())
    return Worth(float(short), float(over), float(apart), kept, promised)


def _aimed_kw(run: FaultyRun) -> Iterator[float]:
    reference_kw = float("nan")
    for one in run.of_stage("solve"):
        if one.agent == CENTRAL:
            reference_kw = control_judges.reference_kw(run, one, reference_kw)
            has_kw = true_mpp_kw(run, one.cycle).sum()
            yield control_judges.aim_kw(run, one, reference_kw, has_kw)
