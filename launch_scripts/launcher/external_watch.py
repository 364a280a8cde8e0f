"""Watches the agents that the launcher does not start, and says how they can join."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from agents.events import Presence
from agents.plan import RunPlan
from bus_schemas.tree import PLANT, some_of


def directions(plan: RunPlan, plan_path: Path, timeout_s: float) -> Iterator[str]:
    """Yield lines that say how each agent that the launcher does not start can join."""
    if not plan.elsewhere:
        return
    yield f"waiting up to {timeout_s:g} s for {', '.join(plan.elsewhere)}, plan: {plan_path}"
    for agent in plan.external:
        yield f"  {agent}: {_place(plan, agent)}"
    for host in dict.fromkeys(plan.addresses.values()):
        command = f"heliarch node --plan plan.json --host {host}"
        yield f"  on {host}, with a copy of the plan: {command}"


def _place(plan: RunPlan, agent: str) -> str:
    listeners = {f"{plan.host_of(name)}:{port}": name for name, port in plan.tcp_ports.items()}
    listens, connects = plan.links.endpoints(agent, plan.tcp_ports, plan.host_of)
    targets = ", ".join(f"{end} ({listeners[end]})" for end in connects)
    parts = [f"listens on {', '.join(listens)}"] if listens else []
    parts += [f"connects to {targets}"] if targets else []
    token = plan.wiring.alive_key(agent)
    return f"{', '.join(parts)}, namespace {plan.bus_namespace}, liveliness token {token}"


class ExternalWatch:
    """Which external agents are present. Times are monotonic [s].

    `complete_at` is None until all have been there once. `gone` are devices that the run cannot go
    on without, and since when: the plant, and any in lockstep, where no message is sent twice.
    `unheard` are the keys on which nothing came in the newest arming round.
    """

    def __init__(self, plan: RunPlan, plan_path: Path, timeout_s: float, began_at: float) -> None:
        self.complete_at = None if plan.elsewhere else began_at
        self.gone: dict[str, float] = {}
        self.unheard: Sequence[str] = ()
        self._plan = plan
        self._plan_path = plan_path
        self._timeout_s = timeout_s
        self._began_at = began_at
        self._never_seen = dict.fromkeys(plan.elsewhere)

    def hear(self, event: Presence, now: float) -> str:
        """Note that an agent has appeared or disappeared; return a message about it."""
        agent, plan = event.agent, self._plan
        name = f"{agent} ({plan.addresses.get(agent, 'external')})"
        when = f"in cycle {event.cycle}" if event.cycle >= 0 else "before cycle 0"
        if not event.alive:
            if event.cycle >= 0 and not plan.lockstep and agent != PLANT:
                return f"{name} is gone {when}; the run goes on without it"
            if event.cycle >= 0 and agent in plan.external:
                self.gone[agent] = now
            return f"{name} is gone {when}"
        if not plan.lockstep:
            self.gone.pop(agent, None)
        if agent not in self._never_seen:
            return f"{name} is back {when}"
        del self._never_seen[agent]
        if not self._never_seen:
            self.complete_at = now
        return f"{name} is here"

    def late(self, now: float) -> str:
        """Name the agents that did not come in time; empty if none is missing yet."""
        if self.complete_at is not None or now <= self._began_at + self._timeout_s:
            return ""
        return (
            f"no sign of {', '.join(self._never_seen)} after {self._timeout_s:g} s: no liveliness "
            f"token was seen; the lines above and {self._plan_path} say where a device finds the "
            "bus"
        )

    def explain(self, failure: str) -> str:
        """Say before the failure of a run that did not begin which external agents are silent.

        One of them is the likely cause, and all others wait for it.
        """
        if not self.unheard:
            return failure
        return f"no answer to the arming rounds came on {some_of(self.unheard)}\n{failure}"
