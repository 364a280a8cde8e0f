"""Keeps recorded messages that their listener did not use in their own cycle: late words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port, listeners, ports
from launch_scripts.verification.recorded_cycles import RecordedCycle

MOST_KEPT: Final = 5_000
"""Messages that are kept at most of one port. Only the newest ones can still be of use."""


class UnusedInputs:
    """What was sent to one agent and has not been used by it yet.

    Parameters
    ----------
    agent
        Name of the agent.
    plan
        Of the recorded run.
    most_kept
        How many messages are kept of a port.
    """

    def __init__(self, agent: str, plan: RunPlan, most_kept: int = MOST_KEPT) -> None:
        self._most_kept = most_kept
        # In lockstep nothing is late.
        heard = () if plan.lockstep else ports(plan.tree)
        self._by_cycle: dict[Port[Message], dict[int, tuple[Message, ...]]] = {
            port: {}
            for port in heard
            if port.signal is not RUN and agent in listeners(port, plan.tree)
        }

    def find(self, port: Port[Message], cycle: int) -> tuple[Message, ...]:
        """Return the messages of a port and a cycle, none if it was used or never recorded.

        Only an external agent has several: nobody knows yet which one could be used.
        """
        return self._by_cycle.get(port, {}).get(cycle, ())

    def keep(self, sent: RecordedCycle, used: Mapping[Port[Message], Message]) -> None:
        """Take in what was sent in a cycle. What is not newer than what was used is forgotten."""
        for port, kept in self._by_cycle.items():
            words, input_used = sent.words(port), used.get(port)
            if kept and input_used is not None:
                for cycle in [cycle for cycle in kept if cycle <= input_used.cycle]:
                    del kept[cycle]
            if words and not any(word is input_used for word in words):
                kept[sent.number] = words
                if len(kept) > self._most_kept:
                    del kept[next(iter(kept))]
