"""What a run in real time asks of the clock and the machine: cycle and processes."""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

from bus_schemas.errors import InputError
from bus_schemas.tree import ROOT, ControlTree, parent_of

Processes: TypeAlias = Literal["agent", "cluster", "zone"] | tuple[str, ...]
"""Agents that share a process, see `Scenario`."""

SLOWEST_PACE: Final = 1e-3
FASTEST_PACE: Final = 1e6

SHORTEST_CYCLE_NS: Final = 100_000
"""A process that waits for a time may wake up this much late, so no cycle can be shorter."""


def parse_pace(pace: str | float | None) -> float | Literal["max"] | None:
    if pace is None or pace == "max":
        return "max" if pace else None
    try:
        found = float(pace)
    except ValueError:
        found = 0.0
    if not SLOWEST_PACE <= found <= FASTEST_PACE:
        raise InputError.of(
            "--pace", f"expected {SLOWEST_PACE:g} to {FASTEST_PACE:g}, or max, got {pace}"
        )
    return found


def cycle_wall_ns(cycle_s: float, pace: float | Literal["max"], where: str) -> int:
    """Return the length of a cycle on the wall clock [ns], 0 in lockstep."""
    if pace == "max":
        return 0
    length_ns = round(cycle_s / pace * 1e9)
    if length_ns < SHORTEST_CYCLE_NS:
        raise InputError.of(
            f"{where} {pace:g}",
            f"expected cycles of {SHORTEST_CYCLE_NS / 1e3:g} us or more, as long "
            f"as it may take to wake a process, got {cycle_s:g} s in {length_ns / 1e3:g} us",
        )
    return length_ns


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
        expected = f"a {processes} between the inverters and the central controller"
        raise InputError.of("processes", f"expected {expected}, got none")
    return tuple(path for path in tree.parents if path and path in found)
