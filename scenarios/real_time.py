"""What a run in real time asks of the clock and the machine: cycle, processes, processors."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Final, Literal, TypeAlias, cast

from agents.cycle import KINDS, Kind
from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError, not_one_of
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


def machine_settings(cpus: Sequence[str], priority: int | None = None) -> MachineSettings:
    """Read the values of `--cpus`: processors such as `0-1`, or `plant=0` for one kind."""
    by_kind: dict[str, tuple[int, ...]] = {}
    for entry in cpus:
        kind, equals, listed = entry.rpartition("=")
        if equals and kind not in KINDS:
            known = not_one_of(KINDS, kind, "a kind of process: ")
            raise InputError.of(f"--cpus {entry}", known)
        by_kind[kind] = _cpu_list(f"--cpus {entry}", listed)
    everywhere = by_kind.pop("", ())
    return MachineSettings(everywhere, cast("dict[Kind, tuple[int, ...]]", by_kind), priority or 0)


def _cpu_list(where: str, text: str) -> tuple[int, ...]:
    """Read a list of processors as the kernel writes it: `0`, `0-3` or `0,2-3`."""
    if not re.fullmatch(r"\d{1,4}(-\d{1,4})?(,\d{1,4}(-\d{1,4})?)*", text):
        raise InputError.of(where, f"expected processors such as 0, 0-3 or plant=0, got {text!r}")
    cpus: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        cpus.update(range(int(first), int(last or first) + 1))
    known = os.sched_getaffinity(0)
    if not cpus or not cpus <= known:
        listed = ", ".join(map(str, sorted(known)))
        raise InputError.of(where, f"expected processors of this machine, {listed}, got {text}")
    return tuple(sorted(cpus))
