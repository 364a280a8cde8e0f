"""Agents that the launcher does not start, but waits for: devices, and agents on other hosts.

A device of the user's own takes the place of a process. It finds the bus by the run's `plan.json`;
`docs/wire.md` says what it must do. `heliarch node` starts the agents of another host.
"""

from __future__ import annotations

from collections.abc import Sequence
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT, RECORDER, ControlTree, some_of
from recordings.read.selection import find_agents

_LONGEST_WAIT_S: Final = 86_400.0
_PORTS: Final = range(1024, 65_536)


def check_externals(
    external: Sequence[str], timeout_s: float, tree: ControlTree
) -> tuple[str, ...]:
    """Check the options about external agents; return the agents in the order of the tree."""
    team = tuple(agent for agent in tree.agents() if agent != RECORDER)
    for agent in external:
        if agent not in team:
            raise InputError(f"--external: expected one of {some_of(team)}, got {agent}")
    if not 0.0 < timeout_s <= _LONGEST_WAIT_S:
        raise InputError(
            f"--external-timeout: expected seconds above 0, up to {_LONGEST_WAIT_S:g}, got "
            f"{timeout_s:g}"
        )
    return tuple(agent for agent in team if agent in external)


def listening(plan: RunPlan) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the agents that need a port, and those that need a second one, beside devices."""
    has_second = plan.external and not plan.keys_folder
    return plan.links.listening, plan.agent_links.listening if has_second else ()


def check_base_port(base_port: int, plan: RunPlan) -> None:
    """Refuse ports that there are not, or that only the system may use."""
    last = base_port + sum(map(len, listening(plan))) - 1
    if base_port not in _PORTS or last not in _PORTS:
        raise InputError(
            f"--base-port: expected ports from {_PORTS[0]} to {_PORTS[-1]}, got "
            f"{base_port} to {last}"
        )


def own_address(text: str) -> IPv4Address | IPv6Address:
    """Read the value of `--address`."""
    try:
        return ip_address(text)
    except ValueError:
        raise InputError(
            f"--address: expected an IP address such as 10.0.0.1, got {text}"
        ) from None


def addresses_of(
    on: Sequence[str], tree: ControlTree, external: Sequence[str], own: str, *, secure: bool
) -> dict[str, str]:
    """Return the address of each agent that `--on` puts on another host; `own` is this host's."""
    found: dict[str, str] = {}
    for text in on:
        where = f"--on {text}"
        address, _, names = text.partition("=")
        try:
            is_loopback = ip_address(address).is_loopback
            agents = find_agents(tree, names)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except ValueError:
            agents = ()
        if not agents:
            raise InputError(f"{where}: expected ADDRESS=AGENTS such as 10.0.0.2=c2/*")
        if not is_loopback and not secure:
            raise InputError(f"{where}: expected --secure with an address that others can reach")
        if not is_loopback and ip_address(own).is_loopback:
            raise InputError(f"{where}: expected --address with this host's address, got {own}")
        for agent in agents:
            if agent == PLANT:
                raise InputError(f"{where}: expected controllers, got plant, which stays here")
            if agent in external or found.setdefault(agent, address) != address:
                raise InputError(f"{where}: expected each agent in one place, got {agent} in two")
    return found
