"""What must hold in every cycle of every run, whatever is killed, frozen, cut off or lost.

A run is judged by its messages alone, by what the wire document promises, so the judge knows
nothing of the agents' insides. Each message says in `missing` which inputs it rests on: what it
should say follows from them. Only `recovery` needs the run of the same plant without faults.

To add an invariant, write it, enter it into `INVARIANTS`, and plant a bug that it must find
(`tests/studies/campaign/planted_bugs.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import ceil, inf
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.control.grid import net_kw
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, SETPOINT, TELEMETRY
from bus_schemas.tree import CENTRAL, ROOT, agent_name
from studies.campaign.parent_invariants import correction, division, help_lines, reports
from studies.campaign.trace import EXACT, Breaches, Decision, FaultyRun

OUT_SHARE: Final = 0.05
"""Share of the rating by which a plant may deliver more than its dispatch, for as long as it likes,
or less than its inverters would, each by itself."""

SETTLED_SHARE: Final = 0.01
"""Share of the rating to which it is as without faults, once it has settled."""

SETTLES_S: Final = 30.0
"""Time after the last fault in which it settles, besides `hold_cycles`."""


class Violation(NamedTuple):
    """An invariant that does not hold, where, and how."""

    invariant: str
    cycle: int
    text: str


def violations(run: FaultyRun) -> Iterator[Violation]:
    """Yield each invariant that does not hold, with the first cycle in which it does not."""
    if run.trace.ended:
        yield Violation("end", len(run.trace.produced), run.trace.ended)
        return
    for name, invariant in INVARIANTS.items():
        for cycle, text in sorted(invariant(run))[:1]:
            yield Violation(name, cycle, text)


def _over_delivery(run: FaultyRun) -> Breaches:
    """Check that the plant does not deliver more than its dispatch."""
    produced = run.trace.produced
    return _lasting(run, np.array([one.delivered_kw - one.dispatch_kw for one in produced]))


def _under_delivery(run: FaultyRun) -> Breaches:
    """Check that it does not deliver less than all inverters would if each acted by itself."""
    tree, produced = run.plan.tree, run.trace.produced
    rating_kw = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
    mpp_kw = np.array([one.inverter_mpp_kw for one in produced])
    dispatch_kw = np.clip([one.dispatch_kw for one in produced], 0.0, rating_kw.sum())
    alone_kw = np.minimum(mpp_kw, np.outer(dispatch_kw, rating_kw / rating_kw.sum()))
    fed_in_kw = net_kw(alone_kw.sum(axis=1), run.plan.grid_law)
    return _lasting(run, fed_in_kw - run.trace.delivered_kw)


def _lasting(run: FaultyRun, beyond_kw: NDArray[np.float64]) -> Breaches:
    """Check that no power is above a share of the rating for longer than the faults allow."""
    since = 0
    for cycle, kw in enumerate(beyond_kw.tolist()):
        if kw <= OUT_SHARE * run.plan.tree.rating_kw(ROOT):
            since = cycle + 1
        elif cycle - since >= run.longest:
            yield since, f"{kw:,.0f} kW beyond what is due, for more than {run.longest} cycles"


def _recovery(run: FaultyRun) -> Breaches:
    """Check that some time after the last fault all is as if there had been none."""
    apart_kw = np.abs(run.trace.delivered_kw - run.healthy_kw)
    for cycle in np.flatnonzero(apart_kw > SETTLED_SHARE * run.plan.tree.rating_kw(ROOT)).tolist():
        if run.is_quiet(cycle):
            yield cycle, f"{apart_kw[cycle]:,.0f} kW apart from the run without faults"


def _inputs(run: FaultyRun) -> Breaches:
    """Check that inputs were sent, have not expired, come in order, and of no replaced process.

    Without a fault none is missing.
    """
    assert run.decisions
    yield from run.wrong_inputs


def _one_authority(run: FaultyRun) -> Breaches:
    """Check that a process sends one message on a port in a cycle.

    In the end there is one process for each port, but for those that woke up hearing nobody.
    """
    yield from run.trace.twice
    for port, of in run.trace.of.items():
        for cycle in filter(run.is_quiet, of):
            if len(of[cycle]) > 1 and port.publisher not in run.zombies:
                yield cycle, f"{len(of[cycle])} processes send {port}"


def _inverters(run: FaultyRun) -> Breaches:
    """Check that an inverter obeys its newest command until its revert time is over, then reverts.

    A fresh command undoes a revert. An inverter with a ramp is not judged.
    """
    applied = [one for one in run.decisions if PRODUCTION.of(ROOT) in one.outputs]
    for leaf in run.plan.tree.leaves:
        near = 1.0, run.plan.tree.rating_kw(leaf)
        for decision, wanted in zip(applied, _in_force(run, leaf, applied), strict=False):
            shown = run.trace.of[TELEMETRY.of(leaf)].get(decision.cycle + 1)
            if shown is None or wanted is None or decision.is_doubtful:
                continue
            got = shown[0].alpha, shown[0].limit_kw
            if any(abs(got[at] - wanted[at]) > EXACT * near[at] for at in (0, 1)):
                yield decision.cycle, f"{leaf} obeys alpha and limit {got}, not {wanted}"


def _in_force(
    run: FaultyRun, leaf: str, applied: Iterable[Decision]
) -> Iterator[tuple[float, float] | None]:
    """Yield alpha and limit [kW] that are in force after each decision; None: not known."""
    site, cycle_s, rating_kw = run.plan.site, run.plan.timing.cycle_s, run.plan.tree.rating_kw(leaf)
    settings, limits = site.settings_of(leaf), run.plan.control.actuator == "limit"
    if settings.ramp_percent_per_s is not None:
        return
    delay = ceil(round((settings.delay_s or 0.0) / cycle_s, 9))
    revert = run.plan.site.revert_of(leaf)
    to = revert.to
    revert_kw = rating_kw * (to if isinstance(to, float) else 1.0)
    after = ceil(round(revert.after_s / cycle_s, 9))
    renewed, ordered = 0, list[tuple[float, float]]()
    for decision in applied:
        command = decision.used[COMMAND.of(leaf)]
        if command is not None:
            renewed = command.cycle
            ordered.append((command.alpha, min(command.power_kw if limits else inf, rating_kw)))
            if to == "share" and command.revert_kw is not None:
                revert_kw = min(command.revert_kw, rating_kw)
        elif ordered:
            ordered.append(ordered[-1])
        if decision.cycle - renewed >= after:
            ordered = [(1.0, revert_kw)] * (delay + 1)
        yield ordered[-1 - delay] if len(ordered) > delay else None


def _tripped(run: FaultyRun) -> Breaches:
    """Check that an inverter which gives nothing, or is not heard, for longer is not counted on."""
    gave_in, newest = dict[str, int](), dict[str, int]()
    for one in run.decisions:
        if one.stage != "estimate":
            continue
        telemetry, leaf = one.used[TELEMETRY.of(one.agent)], one.agent
        if telemetry is not None and telemetry.cycle > newest.get(leaf, -1):
            newest[leaf] = telemetry.cycle
            if telemetry.power_kw > 0.0:
                gave_in[leaf] = one.cycle
        counted_kw = one.outputs[IMPP.of(leaf)].power_kw
        is_none = one.cycle - gave_in.get(leaf, -1) > run.plan.control.hold_cycles
        is_heard = one.used[DISPATCH.of(ROOT)] is not None
        if is_none and is_heard and counted_kw > SETTLED_SHARE * run.plan.tree.rating_kw(leaf):
            yield one.cycle, f"{leaf} counts on {counted_kw:,.1f} kW that are not there"


def _commands(run: FaultyRun) -> Breaches:
    """Check that an inverter is commanded its setpoint, or its share, and to revert to its share.

    It is commanded nothing before it has been measured.
    """
    for one in run.decisions:
        command = one.outputs.get(COMMAND.of(one.agent)) if one.stage == "actuate" else None
        if command is not None:
            if not one.was_measured:
                yield one.cycle, f"{one.agent} is commanded before it has been measured"
            if not one.is_doubtful and one.reported:
                wrong = _wrong_command(run, one)
                yield from ((one.cycle, f"{one.agent} is commanded {text}") for text in wrong)


def _wrong_command(run: FaultyRun, one: Decision) -> Iterator[str]:
    leaf, control = one.agent, run.plan.control
    command, report = one.outputs[COMMAND.of(leaf)], one.reported[IMPP.of(leaf)]
    setpoint, share_kw = one.used[SETPOINT.of(leaf)], one.share_kw(leaf)
    near_kw, impp_kw = EXACT * run.plan.tree.rating_kw(leaf), report.power_kw
    got = command.revert_kw
    if (got is None) != (share_kw is None) or abs((got or 0.0) - (share_kw or 0.0)) > near_kw:
        yield f"to revert to {got}, not {share_kw}"
    target_kw = share_kw if setpoint is None else setpoint.power_kw
    if target_kw is None:
        return
    if report.stale_cycles > control.hold_cycles:
        # One that is not heard is commanded its share, so that it shows itself if it lives.
        if share_kw is not None and abs(command.power_kw - share_kw) > near_kw:
            yield f"{command.power_kw:,.1f} kW and not its share, though it is not heard"
        return
    least_kw = min(target_kw, impp_kw) - near_kw
    most_kw = max(target_kw, control.alpha_floor * impp_kw) + near_kw
    if command.power_kw < least_kw or (
        target_kw < impp_kw - near_kw and command.power_kw > most_kw
    ):
        yield f"{command.power_kw:,.1f} kW of {target_kw:,.1f} kW"


def _silence(run: FaultyRun) -> Breaches:
    """Check that who lives and knows its share acts; without a fault everybody always speaks."""
    control, last = run.plan.control, len(run.trace.produced) - 1
    spoke = {(one.agent, one.cycle, one.stage) for one in run.decisions}
    for one in run.decisions:
        stopped = any(one.cycle in cycles for cycles in run.stopped.get(one.agent, ()))
        if one.cycle == last or stopped or one.used.get(DISPATCH.of(ROOT)) is None:
            continue
        if one.stage == "actuate":
            continue
        if one.stage == "estimate":
            acts = not one.was_measured or (one.agent, one.cycle, "actuate") in spoke
        else:
            acts = (one.agent, one.cycle, "solve") in spoke
            if one.agent == CENTRAL:
                acts = SETPOINT.of(run.plan.tree.children(ROOT)[0]) in one.outputs
            acts |= not control.periods.is_turn(one.node, one.cycle)
        if not acts:
            yield one.cycle, f"{one.agent} does not act, though it knows its share"
    spoken = {(agent, cycle) for agent, cycle, _ in spoke}
    for cycle in filter(run.is_quiet, range(last)):
        for agent in map(agent_name, run.plan.tree.nodes):
            if (agent, cycle) not in spoken:
                yield cycle, f"{agent} says nothing"


INVARIANTS: Final[dict[str, Callable[[FaultyRun], Breaches]]] = {
    "over-delivery": _over_delivery,
    "under-delivery": _under_delivery,
    "recovery": _recovery,
    "inputs": _inputs,
    "one authority": _one_authority,
    "inverters": _inverters,
    "reports": reports,
    "tripped": _tripped,
    "division": division,
    "help": help_lines,
    "correction": correction,
    "commands": _commands,
    "silence": _silence,
}
