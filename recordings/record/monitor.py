"""Follows a run message by message: where it stands now, in bounded memory."""

from __future__ import annotations

from agents.plan import RunPlan
from agents.process.events import Status
from bus_schemas.messages import Message, Production
from bus_schemas.signals import HELP, Port


class RunMonitor:
    """The newest state of a run, and how many cycles the plant has completed."""

    def __init__(self) -> None:
        self.cycles = 0
        self._last: Production | None = None
        self._needy: dict[str, int] = {}

    def see(self, port: Port[Message], message: Message) -> None:
        if isinstance(message, Production):
            self.cycles += 1
            self._last = message
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
            dispatch_kw=last.dispatch_kw,
            available_kw=last.available_kw,
            delivered_kw=last.delivered_kw,
            needy=sorted(node for node, cycle in self._needy.items() if cycle >= last.cycle),
            recorded=recorded,
        )


def longest_pause_s(plan: RunPlan) -> float:
    """Return how long a controller may say nothing in real time [s]."""
    return max(1.0, 2.0 * plan.timing.cycle_wall_ns / 1e9)
