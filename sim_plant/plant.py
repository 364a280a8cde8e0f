"""The plant: inverters under moving clouds, and the operator's dispatch, as one more agent.

sense  on the clock             -> telemetry and meter of the interval that ended, next dispatch
apply  command of each inverter -> production: what really happened in the interval
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import isnan
from typing import Final

import numpy as np
from msgspec import UNSET

from agents.agent import Stage, Turn
from agents.control.offers import is_due
from agents.faults import Trip, trips
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.messages import Meter, Production, Telemetry
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    MEMORY,
    METER,
    OFFER,
    ORDER,
    PRODUCTION,
    TELEMETRY,
)
from bus_schemas.tree import PLANT, ROOT
from sim_plant import Floats
from sim_plant.inverters import Inverters, PlantState, Promise, stated_kw
from sim_plant.meters import Meters
from sim_plant.orders import BEFORE_RUN, Orders
from sim_plant.profile import Profile
from sim_plant.storage import Storages, Store

STANDBY_SHARE: Final = 0.001
"""Share of its rating that a tripped inverter draws."""


class Plant:
    """All inverters of a plant, and the operator who dispatches it.

    Before the run begins the inverters stand under the first sample, uncurtailed. One that hears no
    command then holds its share.
    """

    name = PLANT
    may_skip = False

    def __init__(self, plan: RunPlan, profile: Profile) -> None:
        self._profile = profile
        self._inverters = Inverters(plan)
        self._site = plan.site
        self._trips = [fault for fault in plan.faults.rules if isinstance(fault, Trip)]
        self._tree, self._cycle_s = plan.tree, plan.timing.cycle_s
        self._storages = Storages(plan)
        self._telemetry = tuple(TELEMETRY.of(leaf) for leaf in plan.tree.leaves)
        self._commands = tuple(COMMAND.of(leaf) for leaf in plan.tree.leaves)
        self._storage_commands = tuple(map(COMMAND.of, plan.tree.storage_paths))
        self._meters, self._memories = Meters(plan), tuple(map(MEMORY.of, plan.tree.meters))
        self._orders = Orders(plan)
        self._offers = plan.offer_law
        sense = Stage("sense", (), (ORDER.of(ROOT),), timed=True)
        apply = Stage("apply", (*self._commands, *self._storage_commands, *self._memories))
        self._stages = (sense, apply)
        self._with_offer = (sense, Stage("apply", (*apply.awaits, OFFER.of(ROOT))))

    def initial_state(self) -> PlantState:
        profile = self._profile
        schedule_kw = float(profile.commitment_kw[0]), float(profile.regulation_kw[0])
        dispatch = self._orders.scheduled(BEFORE_RUN, *schedule_kw)
        state = self._inverters.uncurtailed(profile.mpp_kw[0], dispatch)
        memories = (None,) * len(self._memories)
        state = replace(state, stores=self._storages.at_rest(), memories=memories)
        if self._offers is None:
            return state
        first_share = self._offers.first_share
        return replace(state, promise=Promise(0, first_share, first_share))

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        has_offer = self._offers is not None and is_due(self._offers, cycle)
        return self._with_offer if has_offer else self._stages

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        if turn.stage == "sense":
            return self._sense(state, turn)
        return self._apply(state, turn)

    def _sense(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        cycle = max(turn.cycle, 0)
        commitment_kw = float(self._profile.commitment_kw[cycle])
        regulation_kw = float(self._profile.regulation_kw[cycle])
        promise, clear_sky_kw = state.promise, None
        if self._offers is not None:
            promise = promise.at(cycle // self._offers.interval_cycles)
            clear_sky_kw = float(self._profile.clear_sky_kw[cycle])
            commitment_kw = promise.share * clear_sky_kw
        schedule_kw = commitment_kw, regulation_kw, clear_sky_kw
        scheduled = self._orders.scheduled(turn.stamp, *schedule_kw)
        dispatch = self._orders.next(state.dispatch, turn.inputs[ORDER.of(ROOT)], scheduled)
        outputs: list[Delivery] = [(DISPATCH.of(ROOT), dispatch), *self._metered(state, turn)]
        measured_kw = (state.power_kw * (1.0 + self._profile.meter_error[cycle])).tolist()
        alpha, limit_kw = state.alpha.tolist(), state.limit_kw.tolist()
        available_kw = self._available_kw(cycle)
        for position, port in enumerate(self._telemetry):
            telemetry = Telemetry(
                *turn.stamp,
                power_kw=measured_kw[position],
                alpha=alpha[position],
                limit_kw=limit_kw[position],
                available_kw=available_kw[position],
            )
            outputs.append((port, telemetry))
        is_tripped = self._tripped_storages(max(cycle - 1, 0))
        for node, store, is_off in zip(
            self._tree.storage_paths, state.stores, is_tripped, strict=True
        ):
            telemetry = Telemetry(
                *turn.stamp,
                power_kw=store.power_kw,
                alpha=1.0,
                limit_kw=self._tree.rating_kw(node),
                energy_kwh=UNSET if is_off else store.energy_kwh,
            )
            outputs.append((TELEMETRY.of(node), telemetry))
        return replace(state, dispatch=dispatch, promise=promise), outputs

    def _metered(self, state: PlantState, turn: Turn) -> Iterator[Delivery]:
        stored_kw = [store.power_kw for store in state.stores]
        readings_kw = self._meters.readings_kw(state.power_kw.tolist(), stored_kw)
        found = zip(self._memories, readings_kw, state.memories, strict=True)
        for port, power_kw, memory in found:
            meter = Meter(*turn.stamp, power_kw=power_kw)
            if port.node == ROOT:
                meter.frequency_hz = self._profile.frequency_at(max(turn.cycle, 0))
            if memory is not None:
                meter.correction_kw, meter.error_kw = memory.correction_kw, memory.error_kw
                meter.expected_kw, meter.reference_kw = memory.expected_kw, memory.reference_kw
                meter.lacking_kw, meter.tried_kw = memory.lacking_kw, memory.tried_kw
                meter.helped_share = memory.helped_share
                record = state.record if port.node == ROOT else None
                if record is not None and memory.intervals < record.intervals:
                    meter.record = record.record
            yield METER.of(port.node), meter

    def _available_kw(self, cycle: int) -> list[float | None]:
        """Return what each inverter states that it could have given in the last interval."""
        ended_kw = self._mpp_kw(max(cycle - 1, 0))
        powers_kw = stated_kw(ended_kw, self._inverters.rating_kw, self._site).tolist()
        return [None if isnan(kw) else kw for kw in powers_kw]

    def _mpp_kw(self, cycle: int) -> Floats:
        """Return the power that each inverter could give; a tripped one draws standby power."""
        mpp_kw: Floats = self._profile.mpp_kw[cycle]
        if self._trips:
            tripped = trips(self._trips, self._tree.leaves, cycle * self._cycle_s)
            mpp_kw = np.where(tripped, -STANDBY_SHARE * self._inverters.rating_kw, mpp_kw)
        return mpp_kw

    def _apply(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        cycle = max(turn.cycle, 0)
        mpp_kw = self._mpp_kw(cycle)
        stores = self._stores(state, turn)
        state = self._inverters.obey(state, map(turn.get, self._commands), turn.cycle)
        power_kw = self._inverters.power_kw(state, mpp_kw)
        if turn.cycle >= 0 and self._offers is not None and is_due(self._offers, turn.cycle):
            offer = turn.get(OFFER.of(ROOT))
            if offer is not None and offer.cycle == turn.cycle:
                state = replace(state, promise=replace(state.promise, coming=offer.share))
        production = Production(
            *turn.stamp,
            dispatch_kw=state.dispatch.power_kw,
            available_kw=float(self._meters.available_kw(mpp_kw)),
            delivered_kw=float(
                self._meters.fed_in_kw(power_kw, np.array([store.power_kw for store in stores]))
            ),
            inverter_mpp_kw=tuple(mpp_kw.tolist()),
            inverter_power_kw=tuple(power_kw.tolist()),
        )
        if stores:
            production.storage_power_kw = tuple(store.power_kw for store in stores)
            production.storage_energy_kwh = tuple(store.energy_kwh for store in stores)
        stated = zip(self._memories, state.memories, strict=True)
        memories = tuple(turn.get(port) or last for port, last in stated)
        memory = memories[0]
        record = state.record if memory is None or memory.record is None else memory
        state = replace(state, power_kw=power_kw, memories=memories, record=record, stores=stores)
        return state, [(PRODUCTION.of(ROOT), production)]

    def _stores(self, state: PlantState, turn: Turn) -> tuple[Store, ...]:
        commands = [turn.get(port) for port in self._storage_commands]
        is_tripped = self._tripped_storages(max(turn.cycle, 0))
        passed = max(turn.cycle - state.cycle, 1)
        return self._storages.obey(state.stores, commands, is_tripped, turn.cycle, passed)

    def _tripped_storages(self, cycle: int) -> list[bool]:
        return trips(self._trips, self._tree.storage_paths, cycle * self._cycle_s)
