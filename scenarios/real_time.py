"""What a run in real time asks of the clock and the machine: cycle, deadlines, processors.

The period of a tier (`control.period_cycles`) says in which cycles it acts, its deadline when its
last message must be out within such a cycle. So a setpoint that is in time is never older than
period x cycle + deadline. A controller that needs longer than a cycle to decide has a period of
several cycles, and its late setpoints are used in the next decision.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Literal, TypeAlias, cast

from agents.cycle import KINDS, Kind, parts_up_to, stage_place
from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError, not_one_of
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, parent_of

Processes: TypeAlias = Literal["agent", "cluster", "zone"] | tuple[str, ...]
"""Agents that share a process, see `Scenario`."""

SLOWEST_PACE: Final = 1e-3
FASTEST_PACE: Final = 1e6

SHORTEST_CYCLE_NS: Final = 100_000
"""A process that waits for a time may wake up this much late. So no cycle can be shorter, and no
deadline can follow that of the stage before it sooner."""

SHORTEST_DEADLINE_MS: Final = SHORTEST_CYCLE_NS / 1e6
LONGEST_DEADLINE_MS: Final = 3.6e9
"""A cycle of an hour at the slowest pace: a scenario may state deadlines and run in lockstep."""


def parse_pace(pace: str | float | None) -> float | Literal["max"] | None:
    """Read the value of `--pace`."""
    if pace is None or pace == "max":
        return "max" if pace else None
    try:
        found = float(pace)
    except ValueError:
        found = 0.0
    if not SLOWEST_PACE <= found <= FASTEST_PACE:
        raise InputError(
            f"--pace: expected {SLOWEST_PACE:g} to {FASTEST_PACE:g}, or max, got {pace}"
        )
    return found


def cycle_wall_ns(cycle_s: float, pace: float | Literal["max"], where: str) -> int:
    """Return the length of a cycle on the wall clock [ns], 0 in lockstep."""
    if pace == "max":
        return 0
    length_ns = round(cycle_s / pace * 1e9)
    if length_ns < SHORTEST_CYCLE_NS:
        raise InputError(
            f"{where} {pace:g}: expected cycles of {SHORTEST_CYCLE_NS / 1e3:g} us or more, as long "
            f"as it may take to wake a process, got {cycle_s:g} s in {length_ns / 1e3:g} us"
        )
    return length_ns


def tier_deadlines_ns(
    deadlines_ms: Sequence[float] | None, tree: ControlTree, cycle_ns: int
) -> tuple[int, ...]:
    """Return when the last message of each tier must be out after the beginning of a cycle [ns].

    Empty: each stage gets its share of the cycle. In lockstep `cycle_ns` is 0, and none is used.
    """
    if deadlines_ms is None:
        return ()
    if len(deadlines_ms) != tree.height + 1:
        raise InputError(
            f"control.deadlines_ms: expected {tree.height + 1} entries, one for each tier, the "
            f"central controller's first, got {len(deadlines_ms)}"
        )
    found = tuple(round(deadline_ms * 1e6) for deadline_ms in deadlines_ms)
    # The stages up to the central controller's solve share the time before its deadline.
    least_ns = parts_up_to(stage_place(CENTRAL, "solve", tree)) * SHORTEST_CYCLE_NS
    # The plant applies the commands halfway between the last deadline and its next tick.
    most_ns = cycle_ns - 2 * SHORTEST_CYCLE_NS if cycle_ns else found[-1]
    apart_ns = min((later - one for one, later in pairwise(found)), default=SHORTEST_CYCLE_NS)
    if found[0] < least_ns or apart_ns < SHORTEST_CYCLE_NS or found[-1] > most_ns:
        longest = f" to {most_ns / 1e6:.10g} ms" if cycle_ns else ""
        raise InputError(
            f"control.deadlines_ms: expected {least_ns / 1e6:.10g} ms{longest}, each "
            f"{SHORTEST_DEADLINE_MS:g} ms or more after the one before, got {list(deadlines_ms)}"
        )
    return found


def process_groups(processes: Processes, tree: ControlTree) -> tuple[str, ...]:
    """Return the parents that share a process with all below them."""
    if isinstance(processes, tuple):
        return processes
    if processes == "agent":
        return ()
    found = {*map(parent_of, tree.leaves)}
    if processes == "zone":
        found = {*map(parent_of, found)}
    if not found - {ROOT}:
        expected = (
            f"a plant that has a {processes} between its inverters and the central controller"
        )
        raise InputError(f"processes: expected {expected}, got none")
    return tuple(path for path in tree.parents if path and path in found)


def machine_settings(cpus: Sequence[str], priority: int | None = None) -> MachineSettings:
    """Read the values of `--cpus`: processors such as `0-1`, or `plant=0` for one kind."""
    by_kind: dict[str, tuple[int, ...]] = {}
    for entry in cpus:
        kind, equals, listed = entry.rpartition("=")
        if equals and kind not in KINDS:
            known = not_one_of(KINDS, kind, "a kind of process: ")
            raise InputError(f"--cpus {entry}: {known}")
        by_kind[kind] = _cpu_list(f"--cpus {entry}", listed)
    everywhere = by_kind.pop("", ())
    return MachineSettings(everywhere, cast("dict[Kind, tuple[int, ...]]", by_kind), priority or 0)


def _cpu_list(where: str, text: str) -> tuple[int, ...]:
    """Read a list of processors as the kernel writes it: `0`, `0-3` or `0,2-3`."""
    if not re.fullmatch(r"\d{1,4}(-\d{1,4})?(,\d{1,4}(-\d{1,4})?)*", text):
        raise InputError(f"{where}: expected processors such as 0, 0-3 or plant=0, got {text!r}")
    cpus: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        cpus.update(range(int(first), int(last or first) + 1))
    known = os.sched_getaffinity(0)
    if not cpus or not cpus <= known:
        listed = ", ".join(map(str, sorted(known)))
        raise InputError(f"{where}: expected processors of this machine, {listed}, got {text}")
    return tuple(sorted(cpus))
