"""Reads the plan of a run from its file, and checks it."""

from __future__ import annotations

import fnmatch
from pathlib import Path
from typing import Final

import msgspec

from agents.faults import check_fault
from agents.plan import RunPlan
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import InputError, listed
from bus_schemas.messages import PROTOCOL
from bus_schemas.tree import ROOT, agent_name, check_name

LONGEST_CYCLE_NS: Final = 3_600_000_000_000
MOST_CYCLES: Final = 10_000_000
MOST_VALUES: Final = 100_000_000
"""Limits of a run: cycles, and cycles times inverters (0.8 GB for one number of each)."""


class _Version(msgspec.Struct):
    """The version of a plan."""

    protocol: int


def load_plan(path: Path) -> RunPlan:
    try:
        data = path.read_bytes()
        protocol = msgspec.json.decode(data, type=_Version).protocol
        if protocol != PROTOCOL:
            raise InputError.of("protocol", f"expected {PROTOCOL}, got {protocol}")
        plan = msgspec.json.decode(data, type=RunPlan)
        check_plan(plan)
    except (OSError, InputError, *UNREADABLE) as error:
        raise InputError(f"{path}: expected the plan.json of a run, got: {error}") from None
    return plan


def check_size(cycles: int, inverters: int, where: str) -> None:
    """Refuse a run that would take more memory than any machine is asked for."""
    most = min(MOST_CYCLES, MOST_VALUES // inverters)
    if not 0 < cycles <= most:
        raise InputError.of(
            where, f"expected up to {most:,} cycles with {inverters:,} inverters, got {cycles:,}"
        )


def check_plan(plan: RunPlan) -> None:
    for where, name in (("plant", plan.plant), ("run_id", plan.run_id)):
        check_name(name, where)  # Files are named after them.
    check_size(plan.timing.cycles, len(plan.tree.leaves), "cycles")
    access = plan.access
    for number, fault in enumerate(plan.faults.rules):
        check_fault(fault, plan.tree, f"faults[{number}]", access.external, access.addresses)
    _check_groups(plan)
    leaves, height = plan.tree.leaves, plan.tree.height
    if not 0 < plan.timing.cycle_ns <= LONGEST_CYCLE_NS:
        got = f"got {plan.timing.cycle_ns:,}"
        raise InputError.of("cycle_ns", f"expected above 0, up to {LONGEST_CYCLE_NS:,}, {got}")
    _check_orders(plan)
    if plan.control.offers is not None:  # Refuse an interval that is not of whole cycles.
        plan.control.offers.law(plan.timing.cycle_s, is_seen=True)
    for number, entry in enumerate(plan.site.settings):
        if not fnmatch.filter(leaves, entry.nodes):
            known = f"inverters ({listed(leaves)}) or a pattern such as c1/*"
            where = f"plant.settings[{number}].nodes"
            raise InputError.of(where, f"expected {known}, got {entry.nodes!r}")
    periods = len(plan.control.periods.cycles)
    if periods != height:
        raise InputError.of("control.period_cycles", f"expected {height} entries, got {periods}")


def _check_orders(plan: RunPlan) -> None:
    rating_kw, taken = plan.tree.rating_kw(ROOT), set[int]()
    for number, order in enumerate(plan.orders):
        if (order.power_kw or 0.0) > rating_kw:
            expected = f"the plant's rating of {rating_kw:.10g} kW at most"
            got = f"got {order.power_kw:.10g} kW"
            raise InputError(f"orders[{number}].power_kw: expected {expected}, {got}")
        cycle = order.cycle(plan.timing.cycle_s)
        if cycle in taken:
            raise InputError(f"orders[{number}].at: expected a cycle without another order")
        taken.add(cycle)


def _check_groups(plan: RunPlan) -> None:
    parents = [*map(agent_name, plan.tree.parents)]
    for group in plan.supervision.groups:
        if group not in parents:
            raise InputError.of("processes", f"expected any of {listed(parents)}, got {group!r}")
