"""A watch over an agent in lockstep: it says what the agent waits for when nothing goes on."""

from __future__ import annotations

import threading
import time
from typing import Any, TypeVar

from agents.events import Waiting
from agents.lifeline import Lifeline
from agents.plan import RunPlan
from agents.sequencer import Sequencer
from bus_schemas.zenoh_bus import ZenohBus

S = TypeVar("S")


class StallWatch:
    """Looks from a thread of its own whether an agent in lockstep goes on, and says if it does not.

    It needs a thread because the agent may hang where it publishes: to a listener that takes
    nothing any more.

    Parameters
    ----------
    plan
        Of the run.
    sequencer, bus, lifeline
        The agent's way through the cycles, its place on the bus, and where to say it.
    """

    def __init__(
        self, plan: RunPlan, sequencer: Sequencer[S], bus: ZenohBus, lifeline: Lifeline
    ) -> None:
        self._timeout_s = plan.stall_timeout_s
        self._sequencer: Sequencer[Any] = sequencer
        self._bus = bus
        self._lifeline = lifeline
        self._stopped = threading.Event()
        if plan.lockstep:
            threading.Thread(target=self._watch, name="stall watch", daemon=True).start()

    def stop(self) -> None:
        """End the watch."""
        self._stopped.set()

    def _watch(self) -> None:
        seen: tuple[object, ...] = ()
        since = time.monotonic()
        told = False
        while not self._stopped.wait(0.1):
            now = self._snapshot()
            if now != seen:
                seen, since, told = now, time.monotonic(), False
            elif not told and time.monotonic() - since > self._timeout_s:
                told = self._tell()

    def _snapshot(self) -> tuple[object, ...]:
        return self._sequencer.cycle, self._sequencer.stage, self._bus.publishing

    def _tell(self) -> bool:
        sequencer, bus = self._sequencer, self._bus
        needs = [(str(port), port.publisher) for port in sorted(sequencer.waiting_for, key=str)]
        blocked_on = str(bus.publishing or "")
        if sequencer.cycle < 0 or not (needs or blocked_on):
            return False
        self._lifeline.tell(Waiting(sequencer.cycle, sequencer.stage, needs, blocked_on))
        return True
