"""What the recorder hears of external agents: nobody else can give an account of them.

It is linked with everybody, so it sees whether they are there, and counts what they send.
"""

from __future__ import annotations

from collections import Counter

from agents.events import ExternalAccount
from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port, ports
from bus_schemas.tree import CENTRAL, ROOT, depth


class ExternalAgents:
    """The external agents of a run and their messages.

    Parameters
    ----------
    plan
        Of the run.

    Attributes
    ----------
    heard
        Their messages that belong into the recording.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.heard = 0
        self._plan = plan
        self._agent_of = {plan.keys.alive_key(agent): agent for agent in plan.external}
        self._recorded: dict[str, Counter[str]] = {agent: Counter() for agent in plan.external}
        self._lost: Counter[str] = Counter()
        self._answers: Counter[Port[Message]] = Counter()
        self._numbered: dict[Port[Message], tuple[int, int]] = {}  # Cycle, next number.

    def named(self, alive_key: str) -> str | None:
        """Return which of them a liveliness token is of, if any."""
        return self._agent_of.get(alive_key)

    def hear(self, port: Port[Message], message: Message, *, is_answer: bool) -> None:
        """Count a message that is recorded, and those that its number shows to be missing before.

        Of several messages in a cycle only the first is an answer. A lower number in a newer cycle
        is that of a device which has begun anew.
        """
        agent = port.publisher
        self.heard += 1
        self._recorded[agent][port.signal.name] += 1
        self._answers[port] += is_answer
        newest, expected = self._numbered.get(port, (-1, 0))
        if message.sequence < expected and message.cycle <= newest:
            return
        self._lost[agent] += max(message.sequence - expected, 0)
        self._numbered[port] = max(message.cycle, newest), message.sequence + 1

    def accounts(self, cycles: int) -> tuple[ExternalAccount, ...]:
        """Return an account of each of them, after so many cycles."""
        expected: Counter[str] = Counter()
        answered: Counter[str] = Counter()
        for port in ports(self._plan.tree):
            if port.publisher in self._recorded:
                due = self._due(port, cycles)
                expected[port.publisher] += due
                answered[port.publisher] += min(self._answers[port], due)
        return tuple(
            ExternalAccount(
                agent, dict(recorded), self._lost[agent], expected[agent], answered[agent]
            )
            for agent, recorded in self._recorded.items()
        )

    def _due(self, port: Port[Message], cycles: int) -> int:
        """How many messages must come on a port in the first cycles, whatever is decided."""
        match port.signal.occurrence:
            case Occurrence.CYCLE:
                return cycles
            case Occurrence.TURN:
                node = ROOT if port.publisher == CENTRAL else port.publisher
                return -(-cycles // self._plan.periods.cycles[depth(node)])
            case _:
                return 0
