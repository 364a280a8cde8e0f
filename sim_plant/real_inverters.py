"""A plant of which some inverters are real: they measure what is simulated of the others."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from agents.agent import Turn
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Production, Telemetry
from bus_schemas.signals import COMMAND
from sim_plant.inverters import PlantState
from sim_plant.plant import Plant
from sim_plant.profile import Profile


@dataclass(frozen=True, slots=True)
class Reading:
    """What an inverter says of itself, at a monotonic time.

    It may not say what it could give. The limit is the one in force, or its rating.
    """

    time_ns: int
    power_kw: float
    available_kw: float | None
    limit_kw: float


class RealInverters(Protocol):
    """Inverters outside of the simulation, by their positions in the control tree."""

    def newest(self) -> Mapping[int, Reading]:
        """Return the newest reading of each."""

    def expired(self, cycle: int) -> Collection[int]:
        """Return those that have said nothing for too long."""

    def command(self, position: int, command: Command) -> None:
        """Hand a command over."""


class PlantWithDevices(Plant):
    """A simulated plant, with the readings of real inverters in place of what is simulated."""

    def __init__(self, plan: RunPlan, profile: Profile, devices: RealInverters) -> None:
        super().__init__(plan, profile)
        self._devices = devices
        self._positions = {node: plan.tree.leaves.index(node) for node, _ in plan.site.devices}

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        readings = self._devices.newest()
        state, outputs = super().step(_measured(state, readings), turn)
        if turn.stage == "sense":
            return state, list(self._sensed(outputs, readings, turn.cycle))
        for node, position in self._positions.items():
            command = turn.get(COMMAND.of(node))
            if command is not None and turn.cycle >= 0:
                self._devices.command(position, command)
        for _, message in outputs:
            if isinstance(message, Production):
                _correct(message, readings)
        return _measured(state, readings), outputs

    def _sensed(
        self, outputs: list[Delivery], readings: Mapping[int, Reading], cycle: int
    ) -> Iterator[Delivery]:
        """Yield what the plant senses, without the telemetry of inverters that say nothing."""
        expired = self._devices.expired(cycle)
        for port, message in outputs:
            if isinstance(message, Telemetry) and port.node in self._positions:
                position = self._positions[port.node]
                if position in expired:
                    continue
                if position in readings:
                    message.available_kw = readings[position].available_kw
            yield port, message


def _measured(state: PlantState, readings: Mapping[int, Reading]) -> PlantState:
    """Return the state with what real inverters measure and obey."""
    power_kw, limit_kw = state.power_kw.copy(), state.limit_kw.copy()
    for position, reading in readings.items():
        power_kw[position], limit_kw[position] = reading.power_kw, reading.limit_kw
    return replace(state, power_kw=power_kw, limit_kw=limit_kw)


def _correct(production: Production, readings: Mapping[int, Reading]) -> None:
    """Write what real inverters produced into what the plant produced."""
    mpp_kw = np.array(production.inverter_mpp_kw)
    power_kw = np.array(production.inverter_power_kw)
    for position, reading in readings.items():
        # An inverter that states no available power is taken to give all it has.
        power_kw[position] = reading.power_kw
        mpp_kw[position] = max(reading.available_kw or 0.0, reading.power_kw)
    production.available_kw, production.delivered_kw = float(mpp_kw.sum()), float(power_kw.sum())
    production.inverter_mpp_kw = tuple(mpp_kw.tolist())
    production.inverter_power_kw = tuple(power_kw.tolist())
