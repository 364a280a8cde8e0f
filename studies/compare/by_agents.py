"""A run of the agents themselves, in memory: for a network that is not perfect."""

from __future__ import annotations

import dataclasses

import numpy as np

from agents.plan import RunPlan, changed
from agents.settings import Actuator, Scheme
from bus_schemas.messages import Message, Production, parse_missing
from bus_schemas.signals import COMMAND, Port
from launch_scripts.simulation import MemoryRun, on_the_clock
from recordings.read.gaps import MissedInputs
from recordings.read.series import RunSeries, SeriesCollector
from sim_plant.profile import Profile
from studies.arrays.control_arrays import is_corrected


def run_by_agents(plan: RunPlan, profile: Profile, scheme: Scheme, actuator: Actuator) -> RunSeries:
    """Run a plan's agents on a profile with this scheme and actuator in place of the plan's own.

    Without faults they run in lockstep, with faults on the virtual clock: in either case the result
    depends on plan and profile alone.
    """
    law = {"scheme": scheme, "actuator": actuator, "correction": is_corrected(plan, scheme)}
    timed = on_the_clock(plan) if plan.faults.rules else plan
    plan = changed(timed, control=law, site={"devices": ()})
    collector, missed, reverts = SeriesCollector(plan), MissedInputs(plan), _Reverts(plan)

    def see(port: Port[Message], message: Message) -> None:
        collector.see(port, message)
        missed.count(port, message.cycle, message.missing)
        if isinstance(message, Production):
            reverts.see(message)

    for _ in MemoryRun(plan, profile, see).cycles():
        pass
    return dataclasses.replace(
        collector.series(scheme),
        of_agents={
            "missed-inputs": sum(of_agent.total() for of_agent in missed.missing.values()),
            "reverted": reverts.percent(),
        },
    )


class _Reverts:
    """Counts the cycles in which inverters have heard no command for their revert time."""

    def __init__(self, plan: RunPlan) -> None:
        leaves = plan.tree.leaves
        after_s = np.array([plan.site.revert_of(leaf).after_s for leaf in leaves])
        self._after_cycles = after_s * 1e9 / plan.timing.cycle_ns
        self._place = {str(COMMAND.of(leaf)): place for place, leaf in enumerate(leaves)}
        self._renewed = np.zeros(len(leaves))
        self._cycles = self._reverted = 0

    def see(self, production: Production) -> None:
        """Count the inverters that have reverted in a cycle; `missing` has who lacks a command."""
        renewed = np.full_like(self._renewed, production.cycle)
        for key, used in map(parse_missing, production.missing):
            if (place := self._place.get(key)) is not None:
                last = self._renewed[place]
                renewed[place] = last if used is None else max(last, used)
        self._renewed = renewed
        self._cycles += len(renewed)
        self._reverted += int((production.cycle - renewed >= self._after_cycles).sum())

    def percent(self) -> float:
        return 100.0 * self._reverted / self._cycles
