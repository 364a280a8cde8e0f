"""What a run in real time asks of the clock, checked before anything starts: cycle and deadlines.

The period of a tier (`control.period_cycles`) says in which cycles it acts, its deadline when its
last word must be out within such a cycle. So a setpoint that is in time is never older than
period x cycle + deadline. A deadline longer than a cycle would leave the next one without its
beginning: a controller that needs longer to decide has a period of several cycles, and what it says
is taken up late.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Literal

from agents.cycle import stage_place
from bus_schemas.errors import InputError
from bus_schemas.tree import CENTRAL, ControlTree

SHORTEST_CYCLE_NS: Final = 100_000
"""Below it no clock can pace a process: one that waits for a time is woken up to so much late."""

_SHORTEST_SLICE_NS: Final = SHORTEST_CYCLE_NS
"""Nor can a stage keep a deadline that is less after that of the stage before it."""

SHORTEST_DEADLINE_MS: Final = SHORTEST_CYCLE_NS / 1e6
LONGEST_DEADLINE_MS: Final = 3.6e9
"""A cycle of an hour at the slowest pace: a scenario may state deadlines and run in lockstep."""

_DEADLINES: Final = "control.deadlines_ms"


def cycle_wall_ns(cycle_s: float, pace: float | Literal["max"], where: str) -> int:
    """Return the length of a cycle on the wall clock [ns], 0 in lockstep.

    Parameters
    ----------
    cycle_s
        Length of a cycle in simulated time.
    pace
        Simulated seconds a second.
    where
        Where the pace comes from, to be named.

    Raises
    ------
    InputError
        The cycle is too short for any clock.
    """
    if pace == "max":
        return 0
    length_ns = round(cycle_s / pace * 1e9)
    if length_ns < SHORTEST_CYCLE_NS:
        resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
        raise InputError(
            f"{where} {pace:g}: a cycle of {cycle_s:g} s would last {length_ns / 1e3:g} us, beyond "
            f"the clock's resolution (it counts in {resolution_ns:g} ns, but a process that waits "
            f"for a time is woken some 100 us late), accepted are cycles of "
            f"{SHORTEST_CYCLE_NS / 1e3:g} us or more"
        )
    return length_ns


def tier_deadlines_ns(
    deadlines_ms: Sequence[float] | None, tree: ControlTree, cycle_ns: int
) -> tuple[int, ...]:
    """Return when the last message of each tier must be out after the beginning of a cycle [ns].

    Parameters
    ----------
    deadlines_ms
        The scenario's, the central controller's first and the direct controllers' last. None: each
        stage gets its share of the cycle, and nothing is returned.
    tree
        The control tree.
    cycle_ns
        Length of a cycle on the wall clock; 0 in lockstep, where deadlines lie idle.

    Raises
    ------
    InputError
        They are not one for each tier, within the cycle, and so far apart that each stage has at
        least as much time as a process is woken late.
    """
    if deadlines_ms is None:
        return ()
    tiers = tree.height + 1
    if len(deadlines_ms) != tiers:
        raise InputError(
            f"{_DEADLINES} has {len(deadlines_ms)} entries, accepted is one for each of the "
            f"{tiers} tiers, the central controller's first and the direct controllers' last"
        )
    found = tuple(
        _deadline_ns(tier, deadline_ms, cycle_ns) for tier, deadline_ms in enumerate(deadlines_ms)
    )
    for tier, (above_ns, below_ns) in enumerate(pairwise(found), start=1):
        if below_ns - above_ns < _SHORTEST_SLICE_NS:
            raise InputError(
                f"{_stated(tier, deadlines_ms[tier])}, accepted is {SHORTEST_DEADLINE_MS:g} ms "
                f"more than that of the tier above it ({deadlines_ms[tier - 1]:g} ms), or later: "
                f"each tier acts after its parent"
            )
    _check_first_stages(found[0], tree)
    if cycle_ns:
        _check_plant(found[-1], cycle_ns, tiers - 1)
    return found


def _deadline_ns(tier: int, deadline_ms: float, cycle_ns: int) -> int:
    """Return the deadline of a tier; refuse one that there cannot be in a cycle."""
    if not SHORTEST_DEADLINE_MS <= deadline_ms <= LONGEST_DEADLINE_MS:
        raise InputError(
            f"{_stated(tier, deadline_ms)}, accepted is a number from {SHORTEST_DEADLINE_MS:g} to "
            f"{LONGEST_DEADLINE_MS:,.0f}"
        )
    deadline_ns = round(deadline_ms * 1e6)
    if cycle_ns and deadline_ns >= cycle_ns:
        raise InputError(
            f"{_stated(tier, deadline_ms)}, accepted is less than the cycle on the wall clock, "
            f"{cycle_ns / 1e6:g} ms"
        )
    return deadline_ns


def _stated(tier: int, deadline_ms: float) -> str:
    return f"{_DEADLINES}[{tier}] is {deadline_ms:.10g} ms"


def _check_first_stages(central_ns: int, tree: ControlTree) -> None:
    """Refuse a deadline of the central controller that leaves no time to the stages before it."""
    stages = stage_place(CENTRAL, "solve", tree)
    if central_ns < stages * _SHORTEST_SLICE_NS:
        raise InputError(
            f"{_stated(0, central_ns / 1e6)}: the {stages} stages from the tick to the central "
            f"controller's solve share it, {central_ns / stages / 1e3:.3g} us each, expected "
            f"{stages * _SHORTEST_SLICE_NS / 1e6:g} ms or more"
        )


def _check_plant(last_ns: int, cycle_ns: int, tier: int) -> None:
    """Refuse a last deadline that leaves the plant no time to go on before its next tick."""
    slice_ns = (cycle_ns - last_ns) / 2.0
    if slice_ns < _SHORTEST_SLICE_NS:
        latest_ms = (cycle_ns - 2 * _SHORTEST_SLICE_NS) / 1e6
        raise InputError(
            f"{_stated(tier, last_ns / 1e6)}: the plant's apply has half of the "
            f"rest of the cycle, {slice_ns / 1e3:.3g} us, accepted is at most {latest_ms:.10g} ms"
        )
