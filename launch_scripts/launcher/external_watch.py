"""Watches the agents that the launcher does not start, and says how they can join."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from agents.events import Complaint, Presence, Status
from agents.plan import RunPlan
from bus_schemas.tree import PLANT


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

    def hear(self, event: Presence, now: float, *, running: bool) -> str:
        """Note that an agent has appeared or disappeared; return a message about it."""
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
                return f"{name} is back, but what it missed since cycle {back} is lost"
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
            f"seen; the lines above and {self._plan_path} say where a device finds the bus"
        )

    def complain(self, complaint: Complaint) -> None:
        """Keep the first complaint about each key of an external agent."""
        if complaint.key.removeprefix(f"{self._plan.plant}/") in self._publisher_of:
            self._complaints.setdefault(complaint.key, complaint.example)

    def explain(self, failure: str, *, running: bool) -> str:
        """Add to a failure how external agents may have caused it.

        Before cycle 0 an agent that does not answer is the likely cause, so it comes first.
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
        """Name the agents that do not answer the arming rounds, the most silent one first."""
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
