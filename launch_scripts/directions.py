"""Says how the agents that the launcher does not start can join a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from agents.plan import RunPlan


def directions(plan: RunPlan, plan_path: Path, timeout_s: float) -> Iterator[str]:
    """Yield lines for the user: what is waited for, and where each agent finds the bus."""
    if not plan.elsewhere:
        return
    yield f"waiting up to {timeout_s:g} s for {', '.join(plan.elsewhere)}, plan: {plan_path}"
    for agent in plan.access.external:
        yield f"  {agent}: {_links(plan, agent)}"
    for host in dict.fromkeys(plan.access.addresses.values()):
        command = f"heliarch node --plan plan.json --host {host}"
        yield f"  on {host}, with a copy of the plan: {command}"


def _links(plan: RunPlan, agent: str) -> str:
    listeners = {
        f"{plan.access.host_of(name)}:{port}": name for name, port in plan.access.tcp_ports.items()
    }
    listens, connects = plan.links.endpoints(agent, plan.access.tcp_ports, plan.access.host_of)
    targets = ", ".join(f"{end} ({listeners[end]})" for end in connects)
    parts = [f"listens on {', '.join(listens)}"] if listens else []
    parts += [f"connects to {targets}"] if targets else []
    token = plan.wiring.alive_key(agent)
    return f"{', '.join(parts)}, namespace {plan.bus_namespace}, liveliness token {token}"
