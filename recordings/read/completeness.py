"""Whether all that was due in a run is there: by cycles, and by sequence numbers."""

from __future__ import annotations

import msgspec

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port


def due_step(plan: RunPlan, port: Port[Message]) -> int:
    """Return in every how many cycles a message is due; 0 where it comes when it is needed."""
    comes_regularly = port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
    return plan.period(port) if comes_regularly else 0


class Shortfall(msgspec.Struct, frozen=True):
    """What is not there of a run.

    Attributes
    ----------
    lost
        Messages between others of their port: told by sequence numbers.
    early_ports
        Ports whose messages stop before the run's end.
    early_messages
        Messages that were still due on them.
    """

    lost: int = 0
    early_ports: int = 0
    early_messages: int = 0

    def __bool__(self) -> bool:
        return bool(self.lost or self.early_ports)


class Completeness:
    """Follows the messages of a run, port by port.

    Parameters
    ----------
    plan
        Of the run.
    """

    def __init__(self, plan: RunPlan) -> None:
        logged = (port for port in plan.keys.ports if port.signal.logged)
        self._step = {port: due_step(plan, port) for port in logged}
        self._last_cycle = {port: -step for port, step in self._step.items()}
        self._last_sequence = dict.fromkeys(self._step, -1)
        self._lost = 0

    def see(self, port: Port[Message], cycle: int, sequence: int) -> None:
        """Take in a message."""
        self._last_cycle[port] = max(self._last_cycle[port], cycle)
        if sequence > self._last_sequence[port]:
            self._lost += sequence - self._last_sequence[port] - 1
            self._last_sequence[port] = sequence

    def shortfall(self, stop_cycle: int | None) -> Shortfall:
        """Return what is not there.

        Parameters
        ----------
        stop_cycle
            Cycle before which the run ended; None: nobody knows, so nothing is due at the end.
        """
        due = []
        for port, step in self._step.items():
            if step and stop_cycle is not None:
                due.append(len(range(self._last_cycle[port] + step, stop_cycle, step)))
        return Shortfall(self._lost, sum(1 for messages in due if messages), sum(due))
