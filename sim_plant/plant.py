"""The plant: inverters under moving clouds, and the operator's dispatch, as one more agent.

sense  on the clock             -> telemetry and meter of the interval that ended, next dispatch
apply  command of each inverter -> production: what really happened in the interval
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from agents.agent import Stage, Turn
from agents.plan import RunPlan
from agents.settings import InverterSettings, Revert
from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Meter, Production, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, METER, PRODUCTION, TELEMETRY
from bus_schemas.tree import PLANT, ROOT
from sim_plant import Floats
from sim_plant.devices import Devices
from sim_plant.profile import Profile


@dataclass(frozen=True, slots=True)
class PlantState:
    """What each inverter obeyed and delivered in the last interval, shape (n,).

    `ordered_alpha` and `ordered_kw` are its commands of the last intervals, the newest first, shape
    (1 + longest delay, n). `renewed` is the cycle of the last command, `revert_kw` the limit that
    it goes to when its revert time is over.
    """

    alpha: Floats
    limit_kw: Floats
    power_kw: Floats
    ordered_alpha: Floats
    ordered_kw: Floats
    renewed: NDArray[np.int64]
    revert_kw: Floats


class Plant:
    """All inverters of a plant, and the operator who dispatches it.

    Before the run begins the inverters stand under the first sample, uncurtailed. The readings of
    real inverters, `devices`, take the place of what is simulated.
    """

    name = PLANT
    may_skip = False

    def __init__(self, plan: RunPlan, profile: Profile, devices: Devices | None = None) -> None:
        tree = plan.tree
        self._profile = profile
        self._devices = devices
        self._limits = plan.actuator == "limit"
        self._available_bias = plan.available_bias
        self._rating_kw = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
        self._plant_rating_kw = tree.rating_kw(ROOT)
        self._take_settings([plan.settings_of(leaf) for leaf in tree.leaves], plan.cycle_ns / 1e9)
        self._telemetry = tuple(TELEMETRY.of(leaf) for leaf in tree.leaves)
        self._commands = tuple(COMMAND.of(leaf) for leaf in tree.leaves)
        self._dispatch = DISPATCH.of(ROOT)
        self._meter = METER.of(ROOT)
        self._production = PRODUCTION.of(ROOT)
        self._stages = (Stage("sense", (), timed=True), Stage("apply", self._commands))

    def _take_settings(self, settings: list[InverterSettings], cycle_s: float) -> None:
        reverts = [entry.revert or Revert(inf, "release") for entry in settings]
        self._revert_cycles = np.array([revert.after_s for revert in reverts]) / cycle_s
        self._heeds_revert_kw = [revert.to == "request" for revert in reverts]
        shares = [1.0 if isinstance(revert.to, str) else revert.to for revert in reverts]
        self._revert_kw = self._rating_kw * shares
        self._delay = np.array([ceil((entry.delay_s or 0.0) / cycle_s) for entry in settings])
        ramps = [entry.ramp_percent_per_s or inf for entry in settings]
        self._step = np.array(ramps) / 100.0 * cycle_s

    def initial_state(self) -> PlantState:
        """Every inverter at its maximum under the first sample."""
        first_kw = self._profile.mpp_kw[0]
        free = np.ones_like(first_kw)
        kept = (1 + max(self._delay), 1)
        return PlantState(
            alpha=free,
            limit_kw=self._rating_kw,
            power_kw=first_kw,
            ordered_alpha=np.tile(free, kept),
            ordered_kw=np.tile(self._rating_kw, kept),
            renewed=np.zeros(len(first_kw), dtype=np.int64),
            revert_kw=self._revert_kw,
        )

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return self._stages

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        if self._devices is not None:
            state = self._read(state, self._devices)
        if turn.stage == "sense":
            return state, self._sense(state, turn)
        return self._apply(state, turn)

    def _read(self, state: PlantState, devices: Devices) -> PlantState:
        """Return the state with what real inverters measure and obey."""
        devices.read()
        power_kw, limit_kw = state.power_kw.copy(), state.limit_kw.copy()
        for place, reading in devices.newest.items():
            power_kw[place], limit_kw[place] = reading.power_kw, reading.limit_kw
        return replace(state, power_kw=power_kw, limit_kw=limit_kw)

    def _sense(self, state: PlantState, turn: Turn) -> list[Delivery]:
        cycle = max(turn.cycle, 0)
        commitment_kw = float(self._profile.commitment_kw[cycle])
        regulation_kw = float(self._profile.regulation_kw[cycle])
        dispatch = Dispatch(
            *turn.stamp,
            power_kw=commitment_kw + regulation_kw,
            plant_rating_kw=self._plant_rating_kw,
            commitment_kw=commitment_kw,
            regulation_kw=regulation_kw,
        )
        meter = Meter(*turn.stamp, power_kw=float(state.power_kw.sum()))
        outputs: list[Delivery] = [(self._dispatch, dispatch), (self._meter, meter)]
        silent = set() if self._devices is None else self._devices.silent(turn.cycle)
        measured_kw = (state.power_kw * (1.0 + self._profile.meter_error[cycle])).tolist()
        alpha, limit_kw = state.alpha.tolist(), state.limit_kw.tolist()
        available_kw = self._available_kw(cycle)
        for place, port in enumerate(self._telemetry):
            if place not in silent:
                telemetry = Telemetry(
                    *turn.stamp,
                    power_kw=measured_kw[place],
                    alpha=alpha[place],
                    limit_kw=limit_kw[place],
                    available_kw=available_kw[place],
                )
                outputs.append((port, telemetry))
        return outputs

    def _available_kw(self, cycle: int) -> list[float | None]:
        """Return what each inverter says that it could have given in the interval that ended."""
        found: list[float | None] = [None] * len(self._rating_kw)
        if self._available_bias is not None:
            stated_kw = self._profile.mpp_kw[max(cycle - 1, 0)] * (1.0 + self._available_bias)
            found = np.minimum(stated_kw, self._rating_kw).tolist()
        if self._devices is not None:
            for place, reading in self._devices.newest.items():
                found[place] = reading.available_kw
        return found

    def _apply(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        cycle = max(turn.cycle, 0)
        mpp_kw = self._profile.mpp_kw[cycle]
        state = self._obey(state, turn)
        # The paper's inverter gives the share alpha of its maximum, cloud by cloud. A real one
        # holds a power limit in its own fast loop (SunSpec model 123, `WMaxLimPct`).
        share = np.ones_like(state.alpha) if self._limits else state.alpha
        power_kw = np.minimum(share * mpp_kw, state.limit_kw)
        if self._devices is not None:
            mpp_kw = mpp_kw.copy()
            for place in self._devices.places:
                command = turn.get(self._commands[place])
                if command is not None and turn.cycle >= 0:
                    self._devices.command(place, command)
            for place, reading in self._devices.newest.items():
                # What states no possible power is taken to give all it has.
                power_kw[place] = reading.power_kw
                mpp_kw[place] = max(reading.available_kw or 0.0, reading.power_kw)
        desired_kw = float(self._profile.commitment_kw[cycle] + self._profile.regulation_kw[cycle])
        production = Production(
            *turn.stamp,
            desired_kw=desired_kw,
            possible_kw=float(mpp_kw.sum()),
            delivered_kw=float(power_kw.sum()),
            inverter_mpp_kw=tuple(mpp_kw.tolist()),
            inverter_power_kw=tuple(power_kw.tolist()),
        )
        return replace(state, power_kw=power_kw), [(self._production, production)]

    def _obey(self, state: PlantState, turn: Turn) -> PlantState:
        """Obey the commands; an inverter that has heard none for its revert time reverts.

        What an inverter is told takes effect after its delay, and as fast as its ramp allows.
        """
        alpha, limit_kw = state.ordered_alpha[0].tolist(), state.ordered_kw[0].tolist()
        renewed, revert_kw = state.renewed.tolist(), state.revert_kw.tolist()
        for place, port in enumerate(self._commands):
            command = turn.get(port)
            if command is not None and (turn.cycle < 0 or command.cycle >= renewed[place]):
                alpha[place] = command.alpha
                renewed[place] = max(command.cycle, 0)
                if self._limits:
                    limit_kw[place] = min(command.power_kw, self._rating_kw[place])
                if command.revert_kw is not None and self._heeds_revert_kw[place]:
                    revert_kw[place] = min(command.revert_kw, self._rating_kw[place])
        renewed_in, reverts_to_kw = np.array(renewed), np.array(revert_kw)
        ordered_alpha = np.vstack([alpha, state.ordered_alpha[:-1]])
        ordered_kw = np.vstack([limit_kw, state.ordered_kw[:-1]])
        is_over = turn.cycle - renewed_in >= self._revert_cycles
        ordered_alpha[:, is_over] = 1.0
        ordered_kw[:, is_over] = reverts_to_kw[is_over]
        every, step_kw = np.arange(len(self._delay)), self._step * self._rating_kw
        return replace(
            state,
            alpha=_towards(ordered_alpha[self._delay, every], state.alpha, self._step),
            limit_kw=_towards(ordered_kw[self._delay, every], state.limit_kw, step_kw),
            ordered_alpha=ordered_alpha,
            ordered_kw=ordered_kw,
            renewed=renewed_in,
            revert_kw=reverts_to_kw,
        )


def _towards(wanted: Floats, now: Floats, step: Floats) -> Floats:
    """Return what is wanted, as far as a step from now reaches."""
    return np.clip(wanted, now - step, now + step)
