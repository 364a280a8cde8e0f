"""Runs in memory with fault rules."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from memory_runs import Sent, run_in_memory

from bus_schemas.faults import FaultRule
from launch_scripts.launcher.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from launch_scripts.scenarios.fault_rules import parse_fault
from launch_scripts.scenarios.preparation import Preparation


def run_with(
    prepared: Preparation,
    rules: Sequence[FaultRule | str] = (),
    restart_takes_s: float = RESTART_TAKES_S,
    **changes: object,
) -> tuple[MemoryRun, Sent]:
    """Run through in memory, by a virtual clock if there are rules, also as `--fault` has them."""
    faults = tuple(parse_fault(rule) if isinstance(rule, str) else rule for rule in rules)
    plan = msgspec.structs.replace(prepared.plan, faults=faults, **changes)
    return run_in_memory(on_the_clock(plan) if faults else plan, prepared.profile, restart_takes_s)
