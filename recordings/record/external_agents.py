"""What the recorder counts of external agents, which report nothing themselves."""

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
        self._agent_of = {plan.wiring.alive_key(agent): agent for agent in plan.elsewhere}
        theirs = [port for port in ports(plan.tree) if port.publisher in plan.elsewhere]
        self._found = {port: PortGaps() for port in theirs}
        # Ports whose messages come regularly, with the cycles from one to the next.
        self._steps = {port: step for port in theirs if (step := due_step(plan, port))}
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
        found = self._found[port]
        is_first = message.cycle > found.newest
        found.see(message.cycle, message.sequence, message.incarnation)
        self._answers[port] += is_first
        return is_first

    def have_answered(self, cycles: int) -> bool:
        """Return whether the last message due in so many cycles has come on each port."""
        return all(
            self._found[port].newest >= (cycles - 1) // step * step
            for port, step in self._steps.items()
        )

    def accounts(self, cycles: int) -> tuple[ExternalAccount, ...]:
        """Return an account of each of them, after so many cycles."""
        return tuple(self._account(agent, cycles) for agent in self._agent_of.values())

    def _account(self, agent: str, cycles: int) -> ExternalAccount:
        own = {port: found for port, found in self._found.items() if port.publisher == agent}
        due = {port: -(-cycles // step) for port, step in self._steps.items() if port in own}
        recorded: Counter[str] = Counter()
        for port, found in own.items():
            recorded[port.signal.name] += found.messages
        return ExternalAccount(
            agent,
            recorded=dict(+recorded),
            lost=sum(found.lost for found in own.values()),
            expected=sum(due.values()),
            answered=sum(min(self._answers[port], number) for port, number in due.items()),
            outages=tuple(self._outages.get(agent, ())),
        )
