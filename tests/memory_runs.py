"""Runs in memory, and all that is sent in them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from plans_by_hand import with_changes

from agents.faults import Fault
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message, Production
from bus_schemas.signals import Port
from launch_scripts.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from scenarios.fault_rules import parse_fault
from scenarios.preparation import Preparation
from sim_plant.profile import Profile


def timeless(message: Message) -> Message:
    """Return a message without the times at which it was decided and sent."""
    return msgspec.structs.replace(message, publish_time_ns=0, ready_time_ns=0)


class Sent:
    """All messages that were sent in a run, in their order."""

    def __init__(self) -> None:
        self.messages: list[Delivery] = []
        self._of: defaultdict[Port[Message], dict[int, Any]] = defaultdict(dict)

    def __call__(self, port: Port[Message], message: Message) -> None:
        self.messages.append((port, message))
        self._of[port][message.cycle] = message

    def of(self, port: Port[Message]) -> dict[int, Any]:
        """Each cycle's message of a port."""
        return self._of[port]

    @property
    def produced(self) -> list[Production]:
        """What the plant delivered, cycle by cycle."""
        return [message for _, message in self.messages if isinstance(message, Production)]

    @property
    def power_kw(self) -> NDArray[np.float64]:
        """Power of each inverter [kW], shape (cycles, n)."""
        return np.array([one.inverter_power_kw for one in self.produced])


def run_in_memory(plan: RunPlan, profile: Profile) -> tuple[MemoryRun, Sent]:
    """Run a plan through under a profile, and hear all that is sent."""
    sent = Sent()
    run = MemoryRun(plan, profile, sent)
    assert list(run.cycles()) == list(range(plan.timing.cycles))
    run.close()
    return run, sent


def add_zombie(run: MemoryRun, name: str, begin_s: float, end_s: float) -> None:
    """Replace a controller that stands still; it wakes up beside its successor, hearing nobody."""

    def stand_still() -> None:
        old = run.remove(name)
        old.name = f"{name} {begin_s}"  # So nothing on the bus is for it.
        run.after(RESTART_TAKES_S, lambda: run.start(name))
        run.at(end_s, lambda: run.driver.join(old))

    run.at(begin_s, stand_still)


def run_with(
    prepared: Preparation,
    rules: Sequence[Fault | str] = (),
    **changes: object,
) -> tuple[MemoryRun, Sent]:
    """Run through by a virtual clock if there are fault rules, also as `--fault` has them."""
    faults = tuple(parse_fault(rule) if isinstance(rule, str) else rule for rule in rules)
    plan = with_changes(prepared.plan, faults=faults, **changes)
    return run_in_memory(on_the_clock(plan) if faults else plan, prepared.profile)
