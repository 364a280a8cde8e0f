"""Follows a run message by message: where it stands, and the plant's power so far."""

from __future__ import annotations

from dataclasses import dataclass, field

from agents.events import PlantPower, Status
from bus_schemas.messages import Dispatch, Message, Production
from bus_schemas.signals import HELP, Port


@dataclass
class RunMonitor:
    """The run so far.

    Attributes
    ----------
    plant
        The plant's power, one entry for each complete cycle.
    """

    plant: PlantPower = field(default_factory=PlantPower)
    _regulation_kw: dict[int, float] = field(default_factory=dict)
    _last: Production | None = None
    _needy: dict[str, int] = field(default_factory=dict)

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message."""
        if isinstance(message, Production):
            self._last = message
            self.plant.desired_kw.append(message.desired_kw)
            self.plant.regulation_kw.append(self._regulation_kw.pop(message.cycle, 0.0))
            self.plant.possible_kw.append(message.possible_kw)
            self.plant.delivered_kw.append(message.delivered_kw)
        elif isinstance(message, Dispatch):
            self._regulation_kw[message.cycle] = message.regulation_kw
        else:
            self.see_head(port, message.cycle)

    def see_head(self, port: Port[Message], cycle: int) -> None:
        """Take in a message of which only the cycle is known."""
        if port.signal is HELP:
            self._needy[port.node] = cycle

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
