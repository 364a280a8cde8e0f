"""Real inverters in a run: which they are, and what a run must be like for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT, ControlTree, some_of
from sim_plant.devices import parse_address


class DeviceTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A real inverter.

    node: Path of the inverter: `c2/inv07`.
    address: `modbus://host:port/unit`, with SunSpec models.
    """

    node: str
    address: str


def devices(
    tables: Iterable[DeviceTable], options: Sequence[str], tree: ControlTree
) -> tuple[tuple[str, str], ...]:
    """Return node and address of each real inverter; options replace what the scenario says."""
    found = {table.node: ("devices", table.address) for table in tables}
    for option in options:
        node, _, address = option.partition("=")
        found[node] = ("--device", address)
    for node, (where, address) in found.items():
        if node not in tree.leaves:
            raise InputError(f"{where}: expected one of {some_of(tree.leaves)}, got {node}")
        parse_address(address, f"{where} {node}")
    return tuple((leaf, found[leaf][1]) for leaf in tree.leaves if leaf in found)


def check_devices(plan: RunPlan) -> None:
    """Refuse real inverters where a run cannot have them."""
    if not plan.devices:
        return
    pace = plan.cycle_wall_ns and plan.cycle_ns / plan.cycle_wall_ns
    for is_right, expected, got in (
        (not plan.lockstep, "--pace 1 with it", "lockstep"),
        (pace == 1.0, "--pace 1 with it", f"{pace:g}"),
        (plan.actuator == "limit", "--actuator limit with it", plan.actuator),
        (PLANT not in plan.external, "our own plant with it", "an external one"),
    ):
        if not is_right:
            raise InputError(f"device {plan.devices[0][0]}: expected {expected}, got {got}")
