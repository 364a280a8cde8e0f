"""What must hold in every cycle of every run, whatever is killed, frozen, cut off or lost.

A run is judged by its messages alone, beside the run of the same plant without faults. So the
judge knows nothing of the agents' insides, and a mistake in them cannot hide.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Message, Production, Setpoint, Telemetry
from bus_schemas.signals import COMMAND, SETPOINT, TELEMETRY, Port

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
    """The messages of a run that the invariants are about. Call it with each message.

    `ended` says why the run ended before its time; it is empty if it did not.
    """

    produced: list[Production] = field(default_factory=list)
    telemetry: dict[Port[Telemetry], list[Telemetry]] = field(default_factory=dict)
    commands: dict[Port[Command], list[Command]] = field(default_factory=dict)
    setpoints: dict[Port[Setpoint], dict[int, Setpoint]] = field(default_factory=dict)
    twice: list[Delivery] = field(default_factory=list)
    ended: str = ""

    def __call__(self, port: Port[Message], message: Message) -> None:
        if message.cycle < 0:
            return
        match message:
            case Production():
                self.produced.append(message)
            case Telemetry():
                self.telemetry.setdefault(port, []).append(message)  # type: ignore[arg-type]
            case Command():
                self.commands.setdefault(port, []).append(message)  # type: ignore[arg-type]
            case Setpoint():
                heard = self.setpoints.setdefault(port, {})  # type: ignore[arg-type]
                before = heard.get(message.cycle)
                if before is not None and before.incarnation == message.incarnation:
                    self.twice.append((port, message))
                heard[message.cycle] = message

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        return np.array([one.delivered_kw for one in self.produced])

    @property
    def desired_kw(self) -> NDArray[np.float64]:
        return np.array([one.desired_kw for one in self.produced])


def violations(
    plan: RunPlan,
    trace: Trace,
    healthy_kw: NDArray[np.float64],
    last_fault_s: float,
    longest_s: float,
) -> Iterator[Violation]:
    """Yield each invariant that does not hold, with the first cycle in which it does not.

    trace, healthy_kw: The run, and the power of the same one without faults, shape (cycles,) [kW].
    last_fault_s: Simulated time since cycle 0 at which the last fault has ended [s].
    longest_s: How long power may be out of bounds at a time [s]: what the faults of the run allow.
    """
    if trace.ended:
        yield Violation("end", len(trace.produced), trace.ended)
        return
    cycle_s = plan.cycle_ns / 1e9
    longest = round(longest_s / cycle_s)
    settles = round(SETTLES_S / cycle_s) + plan.hold_cycles
    rating_kw = plan.tree.rating_kw("")
    over_kw = trace.delivered_kw - np.maximum(trace.desired_kw, healthy_kw)
    yield from _lasting("over-delivery", over_kw, OVER_SHARE * rating_kw, longest)
    under_kw = _alone_kw(plan, trace) - trace.delivered_kw
    yield from _lasting("under-delivery", under_kw, UNDER_SHARE * rating_kw, longest)
    yield from _settled(plan, trace, healthy_kw, round(last_fault_s / cycle_s) + settles)
    yield from _reverted(plan, trace)
    yield from _shared_out(plan, trace)
    for port, message in trace.twice:
        yield Violation("one authority", message.cycle, f"{port} has two setpoints in one cycle")


def _alone_kw(plan: RunPlan, trace: Trace) -> NDArray[np.float64]:
    """Return what all inverters would give if each acted by itself, shape (cycles,)."""
    rating_kw = np.array([plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves])
    mpp_kw = np.array([one.inverter_mpp_kw for one in trace.produced])
    desired_kw = np.clip(trace.desired_kw, 0.0, rating_kw.sum())
    request_kw = desired_kw[:, None] * (rating_kw / rating_kw.sum())
    return np.asarray(np.minimum(mpp_kw, request_kw).sum(axis=1))


def _lasting(
    name: str, beyond_kw: NDArray[np.float64], limit_kw: float, longest: int
) -> Iterator[Violation]:
    """Check that no power is above a limit for long."""
    since = 0
    for cycle, kw in enumerate(beyond_kw.tolist()):
        if kw <= limit_kw:
            since = cycle + 1
        elif cycle - since >= longest:
            text = f"{kw:,.0f} kW beyond what is due, for more than {longest} cycles"
            yield Violation(name, since, text)
            return


def _settled(
    plan: RunPlan, trace: Trace, healthy_kw: NDArray[np.float64], begin: int
) -> Iterator[Violation]:
    """Check that some time after the last fault all is as if there had been none."""
    apart_kw = np.abs(trace.delivered_kw - healthy_kw)[begin:]
    wrong = np.flatnonzero(apart_kw > SETTLED_SHARE * plan.tree.rating_kw(""))
    if len(wrong):
        text = f"still {apart_kw[wrong[0]]:,.0f} kW apart from the run without faults"
        yield Violation("recovery", begin + int(wrong[0]), text)


def _reverted(plan: RunPlan, trace: Trace) -> Iterator[Violation]:
    """Check that no command stays in force for longer than the revert time."""
    for leaf in plan.tree.leaves:
        revert = plan.settings_of(leaf).revert
        if revert is None:
            continue
        # A cycle more, for what is sent and under way.
        longest = (revert.after_s + plan.follows_within_s(leaf)) * 1e9 / plan.cycle_ns + 1
        rating_kw = plan.tree.rating_kw(leaf)
        commands = trace.commands.get(COMMAND.of(leaf), [])
        sent = [command.cycle for command in commands]
        for telemetry in trace.telemetry.get(TELEMETRY.of(leaf), ()):
            place = bisect_right(sent, telemetry.cycle - 1) - 1
            if place < 0 or telemetry.cycle - 1 - sent[place] <= longest:
                continue
            limit_kw = commands[place].revert_kw if revert.to == "request" else rating_kw
            if isinstance(revert.to, float):
                limit_kw = revert.to * rating_kw
            if telemetry.alpha < 1.0 or (limit_kw is not None and telemetry.limit_kw > limit_kw):
                text = f"{leaf} obeys a command of cycle {sent[place]}"
                yield Violation("revert", telemetry.cycle - 1, text)
                return


def _shared_out(plan: RunPlan, trace: Trace) -> Iterator[Violation]:
    """Check that a parent gives its children no more than its own setpoint, if nothing is old."""
    tree = plan.tree
    for parent in filter(None, tree.parents):
        children = [trace.setpoints.get(SETPOINT.of(child), {}) for child in tree.children(parent)]
        floor_kw = plan.alpha_floor * tree.rating_kw(parent)
        for cycle, own in trace.setpoints.get(SETPOINT.of(parent), {}).items():
            given = [child[cycle] for child in children if cycle in child]
            if not given or any(setpoint.missing for setpoint in given):
                continue
            given_kw = sum(setpoint.power_kw for setpoint in given)
            if given_kw > own.power_kw + floor_kw + _ROUNDING_KW:
                text = f"{parent} shares out {given_kw:,.1f} of {own.power_kw:,.1f} kW"
                yield Violation("shares", cycle, text)
                return
