"""Follows a run message by message: where it stands, and the plant's power so far."""

from __future__ import annotations

from dataclasses import dataclass, field

from agents.lifeline import Status
from bus_schemas.messages import Message, Production
from bus_schemas.signals import HELP, Port


@dataclass
class RunMonitor:
    """The run so far.

    Attributes
    ----------
    desired_kw, possible_kw, delivered_kw
        What was asked of the plant, what it could have given, what it gave; one entry a cycle.
    """

    desired_kw: list[float] = field(default_factory=list)
    possible_kw: list[float] = field(default_factory=list)
    delivered_kw: list[float] = field(default_factory=list)
    _last: Production | None = None
    _needy: dict[str, int] = field(default_factory=dict)

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message."""
        if isinstance(message, Production):
            self._last = message
            self.desired_kw.append(message.desired_kw)
            self.possible_kw.append(message.possible_kw)
            self.delivered_kw.append(message.delivered_kw)
        elif port.signal is HELP:
            self._needy[port.node] = message.cycle

    def status(self, recorded: int) -> Status:
        """Return where the run stands; its cycle is -1 before the first one is over."""
        last = self._last
        if last is None:
            return Status(-1, 0, 0.0, 0.0, 0.0, [], recorded)
        return Status(
            cycle=last.cycle,
            sim_time_ns=last.sim_time_ns,
            desired_kw=last.desired_kw,
            possible_kw=last.possible_kw,
            delivered_kw=last.delivered_kw,
            needy=sorted(node for node, cycle in self._needy.items() if cycle >= last.cycle),
            recorded=recorded,
        )
