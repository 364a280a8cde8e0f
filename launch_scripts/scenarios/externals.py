"""Agents that the launcher does not start, but waits for: devices, and agents on other hosts.

A device of the user's own takes the place of a process. It finds the bus by the run's `plan.json`;
`docs/wire.md` says what it must do. `heliarch node` starts the agents of another host.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Final

from agents.events import Complaint, Presence, Status
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT, RECORDER, ControlTree
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
            near = get_close_matches(agent, team, n=4, cutoff=0.5) or team[:4]
            raise InputError(
                f"--external: expected an agent of this run such as {', '.join(near)}, got {agent}"
            )
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


class ExternalWatch:
    """Which external agents are present, and the messages to the user about them.

    Times are monotonic [s]. `complete_at` is None until all have been there once, `plant_gone_at`
    while an external plant is there.
    """

    def __init__(self, plan: RunPlan, plan_path: Path, timeout_s: float, began_at: float) -> None:
        self.complete_at = None if plan.elsewhere else began_at
        self.plant_gone_at: float | None = None
        self._plan = plan
        self._plan_path = plan_path
        self._timeout_s = timeout_s
        self._began_at = began_at
        self._never_seen = set(plan.elsewhere)
        self._gone_in: dict[str, int] = {}
        self._unheard: list[str] = []
        self._complaints: dict[str, str] = {}
        self._publisher_of = {
            str(port): port.publisher
            for port in plan.wiring.ports
            if port.publisher in plan.elsewhere
        }

    def directions(self) -> Iterator[str]:
        """Yield lines that say how each of them can join."""
        plan = self._plan
        if not plan.elsewhere:
            return
        names = ", ".join(plan.elsewhere)
        yield f"waiting up to {self._timeout_s:g} s for {names}, plan: {self._plan_path}"
        for agent in plan.external:
            yield f"  {agent}: {self._place(agent)}"
        for host in dict.fromkeys(plan.addresses.values()):
            command = f"heliarch node --plan plan.json --host {host}"
            yield f"  on {host}, with a copy of the plan: {command}"

    def hear(self, event: Presence, now: float, *, running: bool) -> str:
        """Note that an agent has come or gone; return a message about it."""
        agent = event.agent
        name = f"{agent} ({self._plan.addresses.get(agent, 'external')})"
        if agent == PLANT:
            self.plant_gone_at = None if event.alive else now
        if event.alive:
            self._never_seen.discard(agent)
            if not self._never_seen and self.complete_at is None:
                self.complete_at = now
            back = self._gone_in.pop(agent, None)
            if back is None or not running:
                return f"{name} is here"
            if self._plan.lockstep:
                self._gone_in[agent] = back
                return f"{name} is back, but what it missed since cycle {back} does not come again"
            return f"{name} is back in cycle {event.cycle}, gone since cycle {back}"
        self._gone_in[agent] = event.cycle
        if not running:
            return f"{name} is gone before cycle 0"
        goes_on = "cannot go on without it" if self._plan.lockstep else "goes on without it"
        rest = "" if agent == PLANT else f"; the run {goes_on}"
        return f"{name} is gone in cycle {event.cycle}{rest}"

    def note(self, status: Status) -> None:
        """Keep the recorder's report on an arming round."""
        self._unheard = status.unheard

    def late(self, now: float) -> str:
        """Name the agents that did not come in time; empty if none is missing yet."""
        if self.complete_at is not None or now <= self._began_at + self._timeout_s:
            return ""
        absent = [agent for agent in self._plan.elsewhere if agent in self._never_seen]
        return (
            f"no sign of {', '.join(absent)} after {self._timeout_s:g} s: no liveliness token was "
            f"seen; where a device finds the bus is said above and in {self._plan_path}"
        )

    def complain(self, complaint: Complaint) -> None:
        """Keep the first complaint about each key of an external agent."""
        if complaint.key.removeprefix(f"{self._plan.plant}/") in self._publisher_of:
            self._complaints.setdefault(complaint.key, complaint.example)

    def explain(self, failure: str, *, running: bool) -> str:
        """Say how external agents may explain a run that does not begin or go on.

        Before cycle 0 one that does not answer is the likely reason, and named first.
        """
        if not running and self._unheard:
            wrong = (f"wrong message on {key}: {text}" for key, text in self._complaints.items())
            return "\n".join([self._silence(), failure, *wrong])
        gone = [f"{agent} went away in cycle {cycle}" for agent, cycle in self._gone_in.items()]
        if not gone:
            return failure
        again = ": in lockstep no message is sent twice" if self._plan.lockstep else ""
        return f"of the external agents {', '.join(gone)}{again}\n{failure}"

    def _silence(self) -> str:
        """Say who does not answer the arming rounds, the most silent one first."""
        silent: dict[str, list[str]] = {}
        for port in self._unheard:
            silent.setdefault(self._publisher_of.get(port, "one of them"), []).append(port)
        ranked = sorted(silent.items(), key=lambda entry: -len(entry[1]))
        gone = dict.fromkeys(self._gone_in, " and is gone")
        return "; ".join(
            f"{agent} (external) does not answer the arming rounds{gone.get(agent, '')}: "
            f"nothing came on {', '.join(silent_ports)}"
            for agent, silent_ports in ranked
        )

    def _place(self, agent: str) -> str:
        plan = self._plan
        listeners = {f"{plan.host_of(name)}:{port}": name for name, port in plan.tcp_ports.items()}
        listens, connects = plan.links.endpoints(agent, plan.tcp_ports, plan.host_of)
        targets = ", ".join(f"{end} ({listeners[end]})" for end in connects)
        parts = [f"listens on {', '.join(listens)}"] if listens else []
        parts += [f"connects to {targets}"] if targets else []
        token = plan.wiring.alive_key(agent)
        return f"{', '.join(parts)}, namespace {plan.bus_namespace}, liveliness token {token}"
