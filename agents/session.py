"""How an agent of a plan joins the bus: its links, its identity, and what it lets the others do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from agents.plan import RunPlan
from bus_schemas.access import Subject, access_rules, common_name, password, session_id
from bus_schemas.links import Links
from bus_schemas.tree import RECORDER, agent_of
from bus_schemas.zenoh_bus import TAP_BATCH_BYTES, KeyFiles, SessionSettings

_LARGEST_BYTES = 65_536
_BYTES_PER_INVERTER = 64
"""A message is not larger than this: the plant's `production` has two numbers for each inverter,
and `missing` names a few inputs of each child."""


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how an agent of the plan, or a standby, joins the bus.

    Without keys, Zenoh asks everybody for a password who connects to a session, or nobody. Devices
    have none, so an agent meets them in a session of their own.
    """
    if plan.keys_folder:
        keys = KeyFiles.of(Path(plan.keys_folder), agent_of(agent))
        subjects: dict[str, Subject] = {
            peer: {"cert_common_names": [common_name(agent_of(peer))]}
            for peer in plan.links.peers(agent)
        }
        return _settings(plan, agent, plan.links, plan.tcp_ports, subjects, keys.config())
    if not plan.secret:
        return _settings(plan, agent, plan.links, plan.tcp_ports)
    devices = None
    if peers := plan.device_links.peers(agent):
        # Nobody can tell a device from a stranger.
        subjects = {peer: {} for peer in ("", *peers)}
        devices = _settings(plan, agent, plan.device_links, plan.tcp_ports, subjects)
    links = plan.agent_links
    subjects = {peer: {"zids": [session_id(plan.secret, peer)]} for peer in links.peers(agent)}
    for top, below in links.pairs:
        if top == agent:
            subjects[below]["usernames"] = [below]
    own: dict[str, object] = {
        "id": session_id(plan.secret, agent),
        "transport/auth/usrpwd/user": agent,
        "transport/auth/usrpwd/password": password(plan.secret, agent),
        "transport/auth/usrpwd/dictionary_file": plan.users_file,
    }
    ports = plan.agent_ports or plan.tcp_ports
    return replace(_settings(plan, agent, links, ports, subjects | {"": {}}, own), devices=devices)


def _settings(
    plan: RunPlan,
    agent: str,
    links: Links,
    tcp_ports: dict[str, int],
    subjects: dict[str, Subject] | None = None,
    further: dict[str, object] | None = None,
) -> SessionSettings:
    listen, connect = links.endpoints(agent, tcp_ports, plan.host_of)
    largest_bytes = _LARGEST_BYTES + _BYTES_PER_INVERTER * len(plan.inverters)
    further = {"transport/link/rx/max_message_size": largest_bytes, **(further or {})}
    if plan.external:  # zenoh-pico closes a link that is idle for 10 s.
        further["transport/link/tx/keep_alive"] = 12
    if agent == RECORDER:
        further["transport/link/tx/batch_size"] = TAP_BATCH_BYTES
    if subjects is not None:
        further["access_control"] = access_rules(
            agent, plan.bus_namespace, plan.keys, plan.wiring, links, subjects
        )
    return SessionSettings(
        plan.bus_namespace, listen, connect, plan.lockstep, further, links.peers(agent)
    )


def users(plan: RunPlan) -> str:
    """Return the users and passwords of a run, as Zenoh reads them from a file."""
    return "".join(f"{agent}:{password(plan.secret, agent)}\n" for agent in plan.processes)
