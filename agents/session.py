"""How an agent of a plan joins the bus: its links, its identity, and what it lets the others do."""

from __future__ import annotations

from pathlib import Path

from agents.plan import RunPlan
from bus_schemas.access import Subject, access_rules, common_name, session_id
from bus_schemas.zenoh_bus import KeyFiles, SessionSettings

_LARGEST_BYTES = 65_536
_BYTES_PER_INVERTER = 64
"""A message is not larger than this: the plant's `production` has two numbers for each inverter,
and `missing` names a few inputs of each child."""


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how an agent of the plan joins the bus."""
    listen, connect = plan.links.endpoints(agent, plan.tcp_ports, plan.host)
    subjects = _subjects(plan)
    rules = None
    if subjects:
        rules = access_rules(
            agent, plan.bus_namespace, plan.keys, plan.wiring, plan.links, subjects
        )
    return SessionSettings(
        plan.bus_namespace,
        listen,
        connect,
        lockstep=plan.lockstep,
        session_id=session_id(plan.secret, agent) if plan.secret else "",
        access=rules,
        keys=KeyFiles.of(Path(plan.keys_folder), agent) if plan.keys_folder else None,
        largest_bytes=_LARGEST_BYTES + _BYTES_PER_INVERTER * len(plan.inverters),
    )


def _subjects(plan: RunPlan) -> dict[str, Subject]:
    """Return how agents recognise each other: by their certificates, or else by their sessions.

    Without keys nobody can tell an external agent's session from a stranger's.
    """
    agents = plan.tree.agents()
    if plan.keys_folder:
        return {agent: {"cert_common_names": [common_name(agent)]} for agent in agents}
    if not plan.secret:
        return {}
    known = {agent: {"zids": [session_id(plan.secret, agent)]} for agent in agents}
    return {**known, **{agent: {} for agent in plan.external}, "": {}}
