"""A plant of which some inverters or storages are real: they measure what others simulate.

An inverter that says nothing for too long is lost: the plant neither meters nor counts what it
last gave. What it may still give is `unknown_kw` of `production`: the plant assumes that it holds
its last limit until its revert time is over, and its revert power from then on. A storage that is
lost counts as 0 kW.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, inf, isnan, nan
from typing import Final, NamedTuple, Protocol

import msgspec
import numpy as np

from agents.agent import Turn
from agents.plan import RunPlan
from agents.settings import InverterSettings
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Meter, Production, Telemetry
from bus_schemas.signals import COMMAND
from bus_schemas.tree import ROOT
from sim_plant.inverters import PlantState
from sim_plant.plant import Plant
from sim_plant.profile import Profile
from sim_plant.storage import Store

METER_PLACE: Final = -1
"""The position of the meter at the point of interconnection, beside those of inverters."""


class Reading(NamedTuple):
    """What a device or the meter says of itself, at a monotonic time.

    An inverter may not say what it could give: NaN. Its limit is the one in force, or its rating.
    energy_kwh: What is stored in a storage.
    """

    time_ns: int
    power_kw: float
    available_kw: float = nan
    limit_kw: float = nan
    energy_kwh: float = nan

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
    """A simulated plant, with the readings of real devices in place of what is simulated."""

    def __init__(self, plan: RunPlan, profile: Profile, devices: RealInverters) -> None:
        super().__init__(plan, profile)
        self._devices = devices
        self._has_meter = bool(plan.site.meter)
        self._positions = {node: plan.tree.devices.index(node) for node, _ in plan.site.devices}
        tree, site, cycle_s = plan.tree, plan.site, plan.timing.cycle_s
        self._limited = {
            at: _Limited(site.settings_of(node), tree.rating_kw(node), cycle_s)
            for node, at in self._positions.items()
            if not tree.is_storage(node)
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
        state = _measured(state, fresh, lost)
        for _, message in outputs:
            if isinstance(message, Production):
                known = [at for at in lost if at in newest and at in self._limited]
                last = [(state.limit_kw[at], newest[at].maximum_kw) for at in known]
                self._correct(message, state.stores, fresh, float(sum(map(min, last))))
        return state, outputs

    def _sensed(self, outputs: list[Delivery], fresh: Mapping[int, Reading]) -> Iterator[Delivery]:
        """Yield what the plant senses, without what devices that say nothing would tell."""
        for port, message in outputs:
            if isinstance(message, Telemetry) and port.node in self._positions:
                reading = fresh.get(self._positions[port.node])
                if reading is None:
                    continue
                stated_kw = reading.available_kw
                message.available_kw = None if isnan(stated_kw) else stated_kw
            if isinstance(message, Meter) and port.node == ROOT and self._has_meter:
                if METER_PLACE not in fresh:
                    continue
                message.power_kw = fresh[METER_PLACE].power_kw
            yield port, message

    def _correct(
        self,
        production: Production,
        stores: Sequence[Store],
        fresh: Mapping[int, Reading],
        assumed_kw: float,
    ) -> None:
        """Write what devices produced into what the plant produced: nothing if they are lost."""
        mpp_kw = np.array(production.inverter_mpp_kw)
        power_kw = np.array(production.inverter_power_kw)
        for at in self._limited:
            reading = fresh.get(at, Reading(0, 0.0))
            mpp_kw[at], power_kw[at] = reading.maximum_kw, reading.power_kw
        production.inverter_mpp_kw = tuple(mpp_kw.tolist())
        production.inverter_power_kw = tuple(power_kw.tolist())
        if stores:
            production.storage_power_kw = tuple(store.power_kw for store in stores)
            production.storage_energy_kwh = tuple(store.energy_kwh for store in stores)
        stored_kw = np.array([store.power_kw for store in stores])
        production.available_kw = float(self._meters.available_kw(mpp_kw))
        production.delivered_kw = float(self._meters.fed_in_kw(power_kw, stored_kw))
        production.unknown_kw = assumed_kw
        if METER_PLACE in fresh:  # It also counts what the lost ones give.
            production.delivered_kw, production.unknown_kw = fresh[METER_PLACE].power_kw, 0.0


def _measured(state: PlantState, fresh: Mapping[int, Reading], lost: list[int]) -> PlantState:
    """Return the state with what devices read in place of what was simulated of them."""
    power_kw, limit_kw = state.power_kw.copy(), state.limit_kw.copy()
    stores = list(state.stores)
    readings = [*fresh.items(), *((at, None) for at in lost)]
    for at, reading in readings:
        if at >= len(power_kw):
            store = stores[at - len(power_kw)]
            energy_kwh = store.energy_kwh if reading is None else reading.energy_kwh
            given_kw = 0.0 if reading is None else reading.power_kw
            stores[at - len(power_kw)] = store._replace(energy_kwh=energy_kwh, power_kw=given_kw)
        elif reading is None:
            power_kw[at] = 0.0
        elif at != METER_PLACE:
            power_kw[at], limit_kw[at] = reading.power_kw, reading.limit_kw
    return replace(state, power_kw=power_kw, limit_kw=limit_kw, stores=tuple(stores))
