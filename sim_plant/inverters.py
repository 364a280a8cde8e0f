"""How the inverters of a plant obey their commands: delay, ramp and revert timer."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from agents.plan import RunPlan
from agents.settings import Revert
from bus_schemas.messages import Command
from sim_plant import Floats


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


class Inverters:
    """The simulated inverters of a plan, in the order of the control tree."""

    def __init__(self, plan: RunPlan) -> None:
        leaves, cycle_s = plan.tree.leaves, plan.timing.cycle_ns / 1e9
        settings = [plan.site.settings_of(leaf) for leaf in leaves]
        reverts = [entry.revert or Revert(inf, "release") for entry in settings]
        shares = [1.0 if isinstance(revert.to, str) else revert.to for revert in reverts]
        ramps = [entry.ramp_percent_per_s or inf for entry in settings]
        self.rating_kw = np.array([plan.tree.rating_kw(leaf) for leaf in leaves])
        self._limits = plan.control.actuator == "limit"
        self._revert_cycles = np.array([revert.after_s for revert in reverts]) / cycle_s
        self._revert_is_commanded = [revert.to == "share" for revert in reverts]
        self._revert_kw = self.rating_kw * shares
        self._delay = np.array([ceil((entry.delay_s or 0.0) / cycle_s) for entry in settings])
        self._step = np.array(ramps) / 100.0 * cycle_s

    def uncurtailed(self, power_kw: Floats) -> PlantState:
        """Return the state in which every inverter delivers its maximum."""
        free = np.ones_like(power_kw)
        kept = (1 + max(self._delay), 1)
        return PlantState(
            alpha=free,
            limit_kw=self.rating_kw,
            power_kw=power_kw,
            ordered_alpha=np.tile(free, kept),
            ordered_kw=np.tile(self.rating_kw, kept),
            renewed=np.zeros(len(power_kw), dtype=np.int64),
            revert_kw=self._revert_kw,
        )

    def obey(self, state: PlantState, commands: Iterable[Command | None], cycle: int) -> PlantState:
        """Obey the commands; an inverter that has heard none for its revert time reverts.

        A command takes effect after its delay, and as fast as the ramp allows.
        """
        alpha, limit_kw = state.ordered_alpha[0].tolist(), state.ordered_kw[0].tolist()
        renewed, revert_kw = state.renewed.tolist(), state.revert_kw.tolist()
        for position, command in enumerate(commands):
            if command is not None and (cycle < 0 or command.cycle >= renewed[position]):
                alpha[position] = command.alpha
                renewed[position] = max(command.cycle, 0)
                if self._limits:
                    limit_kw[position] = min(command.power_kw, self.rating_kw[position])
                if command.revert_kw is not None and self._revert_is_commanded[position]:
                    revert_kw[position] = min(command.revert_kw, self.rating_kw[position])
        renewed_in, reverts_to_kw = np.array(renewed), np.array(revert_kw)
        ordered_alpha = np.vstack([alpha, state.ordered_alpha[:-1]])
        ordered_kw = np.vstack([limit_kw, state.ordered_kw[:-1]])
        is_over = cycle - renewed_in >= self._revert_cycles
        ordered_alpha[:, is_over] = 1.0
        ordered_kw[:, is_over] = reverts_to_kw[is_over]
        every, step_kw = np.arange(len(self._delay)), self._step * self.rating_kw
        return replace(
            state,
            alpha=_towards(ordered_alpha[self._delay, every], state.alpha, self._step),
            limit_kw=_towards(ordered_kw[self._delay, every], state.limit_kw, step_kw),
            ordered_alpha=ordered_alpha,
            ordered_kw=ordered_kw,
            renewed=renewed_in,
            revert_kw=reverts_to_kw,
        )

    def power_kw(self, state: PlantState, mpp_kw: Floats) -> Floats:
        """Return what each inverter delivers [kW].

        The paper's inverter gives the share alpha of its maximum, cloud by cloud. A real one holds
        a power limit in its own fast loop (SunSpec model 123, `WMaxLimPct`).
        """
        share = np.ones_like(state.alpha) if self._limits else state.alpha
        return np.minimum(share * mpp_kw, state.limit_kw)


def _towards(wanted: Floats, now: Floats, step: Floats) -> Floats:
    """Return what is wanted, as far as a step from now reaches."""
    return np.clip(wanted, now - step, now + step)
