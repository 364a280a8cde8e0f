"""Agents and devices of a run that the launcher does not start.

External agents are devices of the user's own in place of a process: each finds the bus by the run's
`plan.json`, and `docs/wire.md` says what it must do. Agents on other hosts are started by
`heliarch node`. Real inverters and storages answer over Modbus.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

import msgspec

from agents.device_profile import PLAIN, DeviceProfile
from agents.plan import RunPlan
from bus_schemas.errors import InputError, not_one_of
from bus_schemas.selection import find_agents
from bus_schemas.tree import OPERATOR, PLANT, RECORDER, ControlTree
from sunspec.addresses import parse_address

_PORTS: Final = range(1024, 65_536)


class DeviceTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A real inverter or storage, or the plant's real meter.

    node: Its path: `c2/inv07`; or `meter`.
    address: `modbus://host:port/unit`, with SunSpec models.
    """

    node: str
    address: str
    profile: DeviceProfile = PLAIN


def external_agents(external: Sequence[str], tree: ControlTree) -> tuple[str, ...]:
    """Return the agents that `--external` names, in the order of the tree."""
    team = (*(agent for agent in tree.agents() if agent != RECORDER), OPERATOR)
    for agent in external:
        if agent not in team:
            raise InputError.of("--external", not_one_of(team, agent))
    return tuple(agent for agent in team if agent in external)


def listening(plan: RunPlan) -> tuple[str, ...]:
    """Return the agents that need a TCP port: none where all links are sockets of this host."""
    return plan.links.listening if plan.access.external or plan.access.keys_folder else ()


def check_base_port(base_port: int, plan: RunPlan) -> None:
    """Refuse ports that do not exist or are reserved for the system."""
    last = base_port + len(plan.links.listening) - 1
    if base_port not in _PORTS or last not in _PORTS:
        raise InputError.of(
            "--base-port",
            f"expected ports from {_PORTS[0]} to {_PORTS[-1]}, got {base_port} to {last}",
        )


def read_address(text: str, where: str = "--address") -> IPv4Address | IPv6Address:
    try:
        return ip_address(text)
    except ValueError:
        raise InputError.of(where, f"expected an IP address such as 10.0.0.1, got {text}") from None


def addresses_of(
    on: Sequence[str], tree: ControlTree, external: Sequence[str], own: str, *, secure: bool
) -> dict[str, str]:
    """Return the address of each agent that `--on` puts on another host; `own` is this host's."""
    found: dict[str, str] = {}
    for text in on:
        where = f"--on {text}"
        address, _, names = text.partition("=")
        agents = find_agents(tree, names, where)
        if not agents:
            raise InputError.of(where, "expected ADDRESS=AGENTS such as 10.0.0.2=c2/*")
        if not secure:
            raise InputError.of(where, "expected --secure with agents on another host")
        if not ip_address(address).is_loopback and ip_address(own).is_loopback:
            raise InputError.of(where, f"expected --address with this host's address, got {own}")
        for agent in agents:
            if agent == PLANT:
                raise InputError.of(where, "expected controllers, got plant, which stays here")
            if agent in external or found.setdefault(agent, address) != address:
                raise InputError.of(where, f"expected each agent in one place, got {agent} in two")
    return found


METER_NODE: Final = "meter"
"""Name of the meter at the point of interconnection among devices."""


def split_devices(options: Iterable[str]) -> dict[str, str]:
    found = {}
    for option in options:
        node, _, address = option.partition("=")
        parse_address(address, f"--device {node}")
        found[node] = address
    return found


def real_devices(
    tables: Iterable[DeviceTable], where: str, options: Sequence[str], tree: ControlTree
) -> tuple[tuple[str, str], ...]:
    """Return name and address of each real device, and of the meter, `meter`.

    Options replace what the scenario says.

    `where` is the place of the scenario's own, for errors.
    """
    chosen = split_devices(options)
    stated = {table.node: table.address for table in tables if table.node not in chosen}
    for node, address in stated.items():
        parse_address(address, f"{where}: {node}")
    addresses = stated | chosen
    known = (*tree.devices, METER_NODE)
    for node in addresses:
        place = "--device" if node in chosen else where
        if node not in known:
            raise InputError(f"{place}: {not_one_of(known, node)}")
        if node == METER_NODE and not addresses.keys() >= set(tree.devices):
            expected = (
                "a device for each inverter and storage, since it cannot meter simulated ones"
            )
            raise InputError(f"{place}: {METER_NODE}: expected {expected}")
    return tuple((node, addresses[node]) for node in known if node in addresses)


def check_devices(plan: RunPlan) -> None:
    """Refuse real devices where a run cannot have them."""
    if not plan.site.devices:
        return
    pace = plan.timing.cycle_wall_ns and plan.timing.cycle_ns / plan.timing.cycle_wall_ns
    for is_right, expected, got in (
        (not plan.timing.lockstep, "--pace 1 with it", "lockstep"),
        (pace == 1.0, "--pace 1 with it", f"{pace:g}"),
        (plan.control.actuator == "limit", "--actuator limit with it", plan.control.actuator),
        (PLANT not in plan.access.external, "our own plant with it", "an external one"),
    ):
        if not is_right:
            raise InputError(f"device {plan.site.devices[0][0]}: expected {expected}, got {got}")
