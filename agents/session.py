"""How an agent of a plan joins the bus: its links, its identity, and what it lets the others do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from agents.plan import RunPlan
from bus_schemas.access import Subject, access_rules, common_name, password, session_id
from bus_schemas.tree import agent_of
from bus_schemas.zenoh_bus import KeyFiles, SessionSettings

_LARGEST_BYTES = 65_536
_BYTES_PER_INVERTER = 64
"""A message is not larger than this: the plant's `production` has two numbers for each inverter,
and `missing` names a few inputs of each child."""


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how an agent of the plan, or a standby, joins the bus."""
    listen, connect = plan.links.endpoints(agent, plan.tcp_ports, plan.host_of)
    settings = SessionSettings(
        plan.bus_namespace,
        listen,
        connect,
        lockstep=plan.lockstep,
        largest_bytes=_LARGEST_BYTES + _BYTES_PER_INVERTER * len(plan.inverters),
        # zenoh-pico closes a link that is idle for 10 s.
        signs_of_life=12 if plan.external else 4,
    )
    if plan.keys_folder:
        keys = KeyFiles.of(Path(plan.keys_folder), agent_of(agent))
        return replace(settings, keys=keys, access=_rules(plan, agent))
    if not plan.secret:
        return settings
    settings = replace(
        settings, session_id=session_id(plan.secret, agent), access=_rules(plan, agent)
    )
    if plan.external:  # A device need not have a password, and Zenoh asks all for one or none.
        return settings
    own = password(plan.secret, agent)
    return replace(settings, user=agent, password=own, users_file=plan.users_file)


def users(plan: RunPlan) -> str:
    """Return the users and passwords of a run, as Zenoh reads them from a file."""
    return "".join(f"{agent}:{password(plan.secret, agent)}\n" for agent in plan.processes)


def _rules(plan: RunPlan, agent: str) -> dict[str, object]:
    peers = plan.links.peers(agent)
    subjects: dict[str, Subject] = {}
    if plan.keys_folder:
        subjects = {peer: {"cert_common_names": [common_name(agent_of(peer))]} for peer in peers}
    else:
        # Without keys nobody can tell an external agent's session from a stranger's.
        subjects = {
            peer: {} if peer in plan.external else {"zids": [session_id(plan.secret, peer)]}
            for peer in peers
        }
        subjects[""] = {}
        if not plan.external:
            for top, below in plan.links.pairs:
                if top == agent:
                    subjects[below]["usernames"] = [below]
    return access_rules(agent, plan.bus_namespace, plan.keys, plan.wiring, plan.links, subjects)
