"""How an agent of a plan joins the bus."""

from __future__ import annotations

from agents.drop_log import DropLog
from agents.plan import RunPlan
from bus_schemas.faulty_bus import FaultyBus
from bus_schemas.links import explicit_links
from bus_schemas.zenoh_bus import SessionSettings, ZenohBus


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how an agent of the plan joins the bus."""
    listen, connect = explicit_links(plan.tree).endpoints(agent, plan.tcp_ports)
    return SessionSettings(plan.bus_namespace, listen, connect, lockstep=plan.lockstep)


def open_bus(plan: RunPlan, agent: str, drop_log: DropLog) -> ZenohBus:
    """Join the bus as an agent of the plan, at the end of imperfect links if it says so."""
    settings, faults = session_settings(plan, agent), plan.network_faults
    if faults.concern(agent):
        return FaultyBus(agent, plan.keys, plan.tree, settings, faults, drop_log)
    return ZenohBus(agent, plan.keys, plan.tree, settings, drop_log)
