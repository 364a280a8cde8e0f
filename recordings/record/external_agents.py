"""The recorder's account of external agents, which give none of themselves."""

from __future__ import annotations

from collections import Counter

from agents.events import ExternalAccount
from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port, ports
from recordings.read.gaps import PortGaps, due_step


class ExternalAgents:
    """The external agents of a run and their messages."""

    def __init__(self, plan: RunPlan) -> None:
        self.heard = 0
        self._plan = plan
        self._agent_of = {plan.keys.alive_key(agent): agent for agent in plan.elsewhere}
        self._recorded: dict[str, Counter[str]] = {agent: Counter() for agent in plan.elsewhere}
        theirs = [port for port in ports(plan.tree) if port.publisher in plan.elsewhere]
        self._gaps = {port: PortGaps() for port in theirs}
        self._last_cycle = dict.fromkeys(theirs, -1)
        self._answers: Counter[Port[Message]] = Counter()
        self._outages: dict[str, list[tuple[int, int | None]]] = {}

    def named(self, alive_key: str) -> str | None:
        """Return whose liveliness token this is, if it is one of theirs."""
        return self._agent_of.get(alive_key)

    def note_presence(self, agent: str, alive: bool, cycle: int) -> None:
        """Note that one of them has come or gone; before cycle 0 that does not count."""
        outages = self._outages.setdefault(agent, [])
        if not alive and cycle >= 0:
            outages.append((cycle, None))
        elif alive and outages:
            outages[-1] = (outages[-1][0], cycle)

    def hear(self, port: Port[Message], message: Message) -> bool:
        """Count a message that is recorded; return whether it is the first of its cycle."""
        self.heard += 1
        self._recorded[port.publisher][port.signal.name] += 1
        self._gaps[port].see(message.cycle, message.sequence, message.incarnation)
        is_first = message.cycle > self._last_cycle[port]
        if is_first:
            self._last_cycle[port] = message.cycle
            self._answers[port] += 1
        return is_first

    def accounts(self, cycles: int) -> tuple[ExternalAccount, ...]:
        """Return an account of each of them, after so many cycles."""
        return tuple(self._account(agent, cycles) for agent in self._recorded)

    def _account(self, agent: str, cycles: int) -> ExternalAccount:
        own = [port for port in self._gaps if port.publisher == agent]
        # How many messages must come on a port, whatever is decided.
        steps = {port: due_step(self._plan, port) for port in own}
        due = {port: -(-cycles // step) if step else 0 for port, step in steps.items()}
        return ExternalAccount(
            agent,
            recorded=dict(self._recorded[agent]),
            lost=sum(self._gaps[port].lost for port in own),
            expected=sum(due.values()),
            answered=sum(min(self._answers[port], due[port]) for port in own),
            outages=tuple(self._outages.get(agent, ())),
        )
