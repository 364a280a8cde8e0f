"""A plant of which some inverters are real: they measure what is simulated of the others.

An inverter that says nothing for too long is lost: the plant neither meters nor counts what it
last gave. What it may still give is `unknown_kw` of `production`: the plant assumes that it holds
its last limit until its revert time is over, and its revert power from then on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from math import ceil, inf, isnan, nan
from typing import Final, NamedTuple, Protocol

import msgspec
import numpy as np

from agents.agent import Turn
from agents.control.grid import net_kw
from agents.plan import RunPlan
from agents.settings import InverterSettings
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Meter, Production, Telemetry
from bus_schemas.signals import COMMAND
from sim_plant.inverters import PlantState
from sim_plant.plant import Plant
from sim_plant.profile import Profile

METER_PLACE: Final = -1
"""The position of the meter at the point of interconnection, beside those of inverters."""


class Reading(NamedTuple):
    """What an inverter or the meter says of itself, at a monotonic time.

    An inverter may not say what it could give: NaN. Its limit is the one in force, or its rating.
    """

    time_ns: int
    power_kw: float
    available_kw: float = nan
    limit_kw: float = nan

    @property
    def maximum_kw(self) -> float:
        """What it could give; if it does not say so, it is taken to give all it has."""
        return float(np.fmax(self.available_kw, self.power_kw))


class RealInverters(Protocol):
    """Devices outside of the simulation, by their places in the control tree, or `METER_PLACE`."""

    def newest(self) -> Mapping[int, Reading]:
        """Return the newest reading of each."""

    def expired(self, cycle: int) -> Collection[int]:
        """Return those that have said nothing for too long."""

    def command(self, position: int, command: Command) -> None:
        """Hand a command over."""


class _Limited:
    """A real inverter that follows limits.

    It states a limit before it holds it: its delay and ramp lie between, and up to a cycle in which
    it reads the limit. Until then its power shows how far it has come. Taken for the power below a
    limit that it holds, it would make an inverter on its way up seem to be in the shade.
    """

    def __init__(self, settings: InverterSettings, rating_kw: float, cycle_s: float) -> None:
        self._stated_kw: deque[float] = deque(maxlen=2 + ceil((settings.delay_s or 0.0) / cycle_s))
        self._step_kw = (settings.ramp_percent_per_s or inf) / 100.0 * rating_kw * cycle_s
        self._least_kw, self._most_kw = inf, -inf

    def limit_kw(self, reading: Reading) -> float:
        """Return the limit that it holds with the newest reading of a cycle."""
        self._stated_kw.append(reading.limit_kw)
        self._least_kw = min(self._least_kw + self._step_kw, *self._stated_kw)
        self._most_kw = max(self._most_kw - self._step_kw, *self._stated_kw)
        return min(max(reading.power_kw, self._least_kw), self._most_kw)


class PlantWithDevices(Plant):
    """A simulated plant, with the readings of real inverters in place of what is simulated."""

    def __init__(self, plan: RunPlan, profile: Profile, devices: RealInverters) -> None:
        super().__init__(plan, profile)
        self._devices = devices
        self._has_meter = bool(plan.site.meter)
        self._positions = {node: plan.tree.leaves.index(node) for node, _ in plan.site.devices}
        tree, site, cycle_s = plan.tree, plan.site, plan.timing.cycle_s
        self._limited = {
            at: _Limited(site.settings_of(node), tree.rating_kw(node), cycle_s)
            for node, at in self._positions.items()
        }

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        newest, expired = self._devices.newest(), self._devices.expired(turn.cycle)
        fresh = {at: reading for at, reading in newest.items() if at not in expired}
        lost = [at for at in self._positions.values() if at not in fresh]
        if turn.stage == "sense":
            held_kw = {
                at: one.limit_kw(fresh[at]) for at, one in self._limited.items() if at in fresh
            }
            state = _measured(state, fresh, lost)
            state.limit_kw[[*held_kw]] = [*held_kw.values()]
            state, outputs = super().step(state, turn)
            return state, list(self._sensed(outputs, fresh))
        inputs = dict(turn.inputs)
        for node, position in self._positions.items():
            port = COMMAND.of(node)
            command = turn.get(port)
            if command is not None and turn.cycle >= 0:
                self._devices.command(position, command)
            if position in lost:  # It does not hear the command.
                inputs[port] = None
        state, outputs = super().step(state, msgspec.structs.replace(turn, inputs=inputs))
        for _, message in outputs:
            if isinstance(message, Production):
                last = [(state.limit_kw[at], newest[at].maximum_kw) for at in lost if at in newest]
                self._correct(message, fresh, float(sum(map(min, last))))
        return _measured(state, fresh, lost), outputs

    def _sensed(self, outputs: list[Delivery], fresh: Mapping[int, Reading]) -> Iterator[Delivery]:
        """Yield what the plant senses, without what devices that say nothing would tell."""
        for port, message in outputs:
            if isinstance(message, Telemetry) and port.node in self._positions:
                reading = fresh.get(self._positions[port.node])
                if reading is None:
                    continue
                stated_kw = reading.available_kw
                message.available_kw = None if isnan(stated_kw) else stated_kw
            if isinstance(message, Meter) and self._has_meter:
                if METER_PLACE not in fresh:
                    continue
                message.power_kw = fresh[METER_PLACE].power_kw
            yield port, message

    def _correct(
        self, production: Production, fresh: Mapping[int, Reading], assumed_kw: float
    ) -> None:
        """Write what devices produced into what the plant produced: nothing if they are lost."""
        mpp_kw = np.array(production.inverter_mpp_kw)
        power_kw = np.array(production.inverter_power_kw)
        for at in self._positions.values():
            reading = fresh.get(at, Reading(0, 0.0))
            mpp_kw[at], power_kw[at] = reading.maximum_kw, reading.power_kw
        production.inverter_mpp_kw = tuple(mpp_kw.tolist())
        production.inverter_power_kw = tuple(power_kw.tolist())
        production.available_kw = net_kw(float(mpp_kw.sum()), self._grid)
        of_storages_kw = sum(kw for kw in production.storage_power_kw or ())
        production.delivered_kw = net_kw(float(power_kw.sum()) + of_storages_kw, self._grid)
        production.unknown_kw = assumed_kw
        if METER_PLACE in fresh:  # It also counts what the lost ones give.
            production.delivered_kw, production.unknown_kw = fresh[METER_PLACE].power_kw, 0.0


def _measured(state: PlantState, fresh: Mapping[int, Reading], lost: list[int]) -> PlantState:
    power_kw, limit_kw = state.power_kw.copy(), state.limit_kw.copy()
    for position, reading in fresh.items():
        if position != METER_PLACE:
            power_kw[position], limit_kw[position] = reading.power_kw, reading.limit_kw
    power_kw[lost] = 0.0
    return replace(state, power_kw=power_kw, limit_kw=limit_kw)
