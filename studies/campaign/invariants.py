"""What must hold in every cycle of every run, whatever is killed, frozen, cut off or lost.

A run is judged by its messages alone, beside the run of the same plant without faults. So the
judge knows nothing of the agents' insides, and a mistake in them cannot hide.

An invariant is a function that yields the cycles of a run in which it does not hold. To add one,
write it, enter it into `INVARIANTS`, and plant a mistake that it must find in the tests.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.messages import Command, Message, Production, Setpoint, Telemetry
from bus_schemas.signals import Port

OVER_SHARE: Final = 0.05
"""Share of the rating by which a plant with faults may deliver more than without, for as long as it
likes."""

UNDER_SHARE: Final = 0.05
"""Share of the rating by which it may deliver less than its inverters would, each by itself."""

SETTLED_SHARE: Final = 0.01
"""Share of the rating to which it is as without faults, once it has settled."""

SETTLES_S: Final = 30.0
"""Time after the last fault in which it settles, besides `hold_cycles`."""

_ROUNDING_KW: Final = 1e-6


class Violation(NamedTuple):
    """An invariant that does not hold, where, and how."""

    invariant: str
    cycle: int
    text: str


@dataclass
class Trace:
    """The messages of a run that the invariants are about, by node. Call it with each message.

    `twice` are setpoints that one process sent again in a cycle. `ended` says why the run ended
    before its time; it is empty if it did not.
    """

    produced: list[Production] = field(default_factory=list)
    telemetry: dict[str, list[Telemetry]] = field(default_factory=dict)
    commands: dict[str, list[Command]] = field(default_factory=dict)
    setpoints: dict[str, dict[int, Setpoint]] = field(default_factory=dict)
    twice: list[tuple[Port[Message], int]] = field(default_factory=list)
    ended: str = ""

    def __call__(self, port: Port[Message], message: Message) -> None:
        if message.cycle < 0:
            return
        match message:
            case Production():
                self.produced.append(message)
            case Telemetry():
                self.telemetry.setdefault(port.node, []).append(message)
            case Command():
                self.commands.setdefault(port.node, []).append(message)
            case Setpoint():
                of_node = self.setpoints.setdefault(port.node, {})
                before = of_node.get(message.cycle)
                if before is not None and before.incarnation == message.incarnation:
                    self.twice.append((port, message.cycle))
                of_node[message.cycle] = message

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        return np.array([one.delivered_kw for one in self.produced])

    @property
    def dispatch_kw(self) -> NDArray[np.float64]:
        return np.array([one.dispatch_kw for one in self.produced])


@dataclass(frozen=True)
class FaultyRun:
    """A run under faults, as the invariants see it.

    healthy_kw: Power of the same run without faults, shape (cycles,) [kW].
    last_fault_s: Simulated time since cycle 0 at which the last fault has ended [s].
    longest_s: How long power may be out of bounds at a time [s]: what the faults allow.
    """

    plan: RunPlan
    trace: Trace
    healthy_kw: NDArray[np.float64]
    last_fault_s: float
    longest_s: float

    @property
    def rating_kw(self) -> float:
        return self.plan.tree.rating_kw("")

    def cycles_of(self, time_s: float) -> int:
        return round(time_s * 1e9 / self.plan.timing.cycle_ns)


Breaches: TypeAlias = Iterator[tuple[int, str]]
"""Cycles in which an invariant does not hold, and how."""


def violations(run: FaultyRun) -> Iterator[Violation]:
    """Yield each invariant that does not hold, with the first cycle in which it does not."""
    if run.trace.ended:
        yield Violation("end", len(run.trace.produced), run.trace.ended)
        return
    for name, invariant in INVARIANTS.items():
        for cycle, text in invariant(run):
            yield Violation(name, cycle, text)


def _over_delivery(run: FaultyRun) -> Breaches:
    """Check that the plant does not deliver more than the dispatch, or than without faults."""
    due_kw = np.maximum(run.trace.dispatch_kw, run.healthy_kw)
    return _lasting(run, run.trace.delivered_kw - due_kw, OVER_SHARE)


def _under_delivery(run: FaultyRun) -> Breaches:
    """Check that it does not deliver less than all inverters would if each acted by itself."""
    tree, trace = run.plan.tree, run.trace
    rating_kw = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
    mpp_kw = np.array([one.inverter_mpp_kw for one in trace.produced])
    dispatch_kw = np.clip(trace.dispatch_kw, 0.0, rating_kw.sum())
    share_kw = dispatch_kw[:, None] * (rating_kw / rating_kw.sum())
    alone_kw = np.minimum(mpp_kw, share_kw).sum(axis=1)
    return _lasting(run, alone_kw - trace.delivered_kw, UNDER_SHARE)


def _lasting(run: FaultyRun, beyond_kw: NDArray[np.float64], share: float) -> Breaches:
    """Check that no power is above a share of the rating for longer than the faults allow."""
    since, longest = 0, run.cycles_of(run.longest_s)
    for cycle, kw in enumerate(beyond_kw.tolist()):
        if kw <= share * run.rating_kw:
            since = cycle + 1
        elif cycle - since >= longest:
            yield since, f"{kw:,.0f} kW beyond what is due, for more than {longest} cycles"
            return


def _recovery(run: FaultyRun) -> Breaches:
    """Check that some time after the last fault all is as if there had been none."""
    settles = run.cycles_of(SETTLES_S) + run.plan.control.hold_cycles
    begin = run.cycles_of(run.last_fault_s) + settles
    apart_kw = np.abs(run.trace.delivered_kw - run.healthy_kw)[begin:]
    wrong = np.flatnonzero(apart_kw > SETTLED_SHARE * run.rating_kw)
    if len(wrong):
        text = f"still {apart_kw[wrong[0]]:,.0f} kW apart from the run without faults"
        yield begin + int(wrong[0]), text


def _revert(run: FaultyRun) -> Breaches:
    """Check that no command stays in force for longer than the revert time."""
    plan = run.plan
    for leaf in plan.tree.leaves:
        revert = plan.site.settings_of(leaf).revert
        if revert is None:
            continue
        # A cycle more, for what is sent and under way.
        obeys_s = revert.after_s + plan.site.follows_within_s(leaf)
        longest = obeys_s * 1e9 / plan.timing.cycle_ns + 1
        rating_kw = plan.tree.rating_kw(leaf)
        commands = run.trace.commands.get(leaf, [])
        sent = [command.cycle for command in commands]
        for telemetry in run.trace.telemetry.get(leaf, ()):
            newest = bisect_right(sent, telemetry.cycle - 1) - 1
            if newest < 0 or telemetry.cycle - 1 - sent[newest] <= longest:
                continue
            limit_kw = commands[newest].revert_kw if revert.to == "share" else rating_kw
            if isinstance(revert.to, float):
                limit_kw = revert.to * rating_kw
            if telemetry.alpha < 1.0 or (limit_kw is not None and telemetry.limit_kw > limit_kw):
                yield telemetry.cycle - 1, f"{leaf} obeys a command of cycle {sent[newest]}"
                return


def _shares(run: FaultyRun) -> Breaches:
    """Check that a parent gives its children no more than its own setpoint, if nothing is old."""
    tree, setpoints = run.plan.tree, run.trace.setpoints
    for parent in filter(None, tree.parents):
        children = [setpoints.get(child, {}) for child in tree.children(parent)]
        floor_kw = run.plan.control.alpha_floor * tree.rating_kw(parent)
        for cycle, own in setpoints.get(parent, {}).items():
            given = [child[cycle] for child in children if cycle in child]
            if not given or any(setpoint.missing for setpoint in given):
                continue
            given_kw = sum(setpoint.power_kw for setpoint in given)
            if given_kw > own.power_kw + floor_kw + _ROUNDING_KW:
                yield cycle, f"{parent} shares out {given_kw:,.1f} of {own.power_kw:,.1f} kW"
                return


def _one_authority(run: FaultyRun) -> Breaches:
    """Check that a node gets one setpoint in a cycle from each process of its parent."""
    for port, cycle in run.trace.twice:
        yield cycle, f"{port} has two setpoints in one cycle"


INVARIANTS: Final[dict[str, Callable[[FaultyRun], Breaches]]] = {
    "over-delivery": _over_delivery,
    "under-delivery": _under_delivery,
    "recovery": _recovery,
    "revert": _revert,
    "shares": _shares,
    "one authority": _one_authority,
}
