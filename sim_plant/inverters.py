"""How the inverters of a plant obey their commands: delay, ramp and revert timer."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from agents.control.allocation import total
from agents.control.grid import Power
from agents.control.share import usable_dispatch_kw
from agents.plan import RunPlan
from agents.plan_parts import Site
from bus_schemas.messages import Command, Dispatch, Memory
from sim_plant import Floats, whole_cycles
from sim_plant.storage import Store


@dataclass(frozen=True, slots=True)
class Promise:
    """Shares of clear sky that the operator accepted: for an interval, and for the next one."""

    interval: int = 0
    share: float = 0.0
    coming: float = 0.0

    def at(self, interval: int) -> Promise:
        """Return what holds in an interval. An offer that did not come repeats the one before."""
        return self if interval == self.interval else Promise(interval, self.coming, self.coming)


@dataclass(frozen=True, slots=True)
class PlantState:
    """What each inverter obeyed and delivered in the last interval, shape (n,).

    `ordered_alpha` and `ordered_kw` are its commands of the last intervals, the newest first, shape
    (1 + longest delay, n). `renewed` is the cycle of the last command, `revert_kw` the limit that
    it goes to when its revert time is over. `cycle` is that of the interval. `dispatch` is what the
    operator wants in it, and `promise` what was offered for it. `memories` are what the
    controllers at the meters stated last, `record` the central one's newest with a record of its
    offers. `stores` are the storages.
    """

    alpha: Floats
    limit_kw: Floats
    power_kw: Floats
    ordered_alpha: Floats
    ordered_kw: Floats
    renewed: NDArray[np.int64]
    revert_kw: Floats
    dispatch: Dispatch
    promise: Promise = Promise()
    memories: tuple[Memory | None, ...] = ()
    record: Memory | None = None
    cycle: int = -1
    stores: tuple[Store, ...] = ()


class Inverters:
    """The simulated inverters of a plan, in the order of the control tree."""

    def __init__(self, plan: RunPlan) -> None:
        leaves, cycle_s = plan.tree.leaves, plan.timing.cycle_ns / 1e9
        settings = [plan.site.settings_of(leaf) for leaf in leaves]
        reverts = [plan.site.revert_of(leaf) for leaf in leaves]
        shares = [1.0 if isinstance(revert.to, str) else revert.to for revert in reverts]
        ramps = [entry.ramp_percent_per_s or inf for entry in settings]
        self.rating_kw = np.array([plan.tree.rating_kw(leaf) for leaf in leaves])
        self.sharing_kw = np.array([plan.tree.sharing_kw(leaf) for leaf in leaves])
        self._limits = plan.control.actuator == "limit"
        self._revert_cycles = np.array(
            [whole_cycles(revert.after_s, cycle_s) for revert in reverts]
        )
        self._revert_is_commanded = [revert.to == "share" for revert in reverts]
        self._revert_kw = self.rating_kw * shares
        delays = [whole_cycles(entry.delay_s or 0.0, cycle_s) for entry in settings]
        self.delay_cycles = np.array(delays, dtype=np.int64)
        self.ramp_per_cycle = np.array(ramps) / 100.0 * cycle_s

    def uncurtailed(self, power_kw: Floats, dispatch: Dispatch) -> PlantState:
        """Return the state before a run: every inverter has delivered its maximum."""
        kept, free = (1 + max(self.delay_cycles), 1), np.ones_like(power_kw)
        return PlantState(
            alpha=free,
            limit_kw=self.rating_kw,
            power_kw=power_kw,
            ordered_alpha=np.tile(free, kept),
            ordered_kw=np.tile(self.rating_kw, kept),
            renewed=np.zeros(len(power_kw), dtype=np.int64),
            revert_kw=self._revert_kw,
            dispatch=dispatch,
        )

    def obey(self, state: PlantState, commands: Iterable[Command | None], cycle: int) -> PlantState:
        """Obey the commands; an inverter that has heard none for its revert time reverts.

        A command takes effect after its delay, and as fast as the ramp allows. When the run begins,
        and until it obeys a command, an inverter holds its share of the first dispatch.
        """
        if state.cycle < 0:
            first = self.first_held(state.power_kw, state.dispatch.power_kw)
            held_alpha, held_kw = (np.tile(one, (len(state.ordered_kw), 1)) for one in first)
            state = replace(
                state,
                alpha=first[0],
                limit_kw=first[1],
                ordered_alpha=held_alpha,
                ordered_kw=held_kw,
            )
        alpha, limit_kw = state.ordered_alpha[0].tolist(), state.ordered_kw[0].tolist()
        renewed, revert_kw = state.renewed.tolist(), state.revert_kw.tolist()
        for position, command in enumerate(commands):
            if command is not None and (cycle < 0 or command.cycle >= renewed[position]):
                alpha[position] = command.alpha
                renewed[position] = max(command.cycle, 0)
                # By a fraction nothing but alpha limits it: a limit that it reverted to is over.
                commanded_kw = command.power_kw if self._limits else inf
                limit_kw[position] = min(commanded_kw, self.rating_kw[position])
                if command.revert_kw is not None and self._revert_is_commanded[position]:
                    revert_kw[position] = min(command.revert_kw, self.rating_kw[position])
        renewed_in, reverts_to_kw = np.array(renewed), np.array(revert_kw)
        passed = max(cycle - state.cycle, 1)  # More than one after cycles that were missed.
        ordered_alpha = _ordered(alpha, state.ordered_alpha, passed)
        ordered_kw = _ordered(limit_kw, state.ordered_kw, passed)
        is_over = cycle - renewed_in >= self._revert_cycles
        ordered_alpha[:, is_over] = 1.0
        ordered_kw[:, is_over] = reverts_to_kw[is_over]
        every, step = np.arange(len(self.delay_cycles)), self.ramp_per_cycle * passed
        wanted = ordered_alpha[self.delay_cycles, every]
        wanted_kw = ordered_kw[self.delay_cycles, every]
        return replace(
            state,
            alpha=towards(wanted, state.alpha, step),
            limit_kw=limit_towards(
                wanted_kw, state.limit_kw, state.power_kw, step * self.rating_kw
            ),
            ordered_alpha=ordered_alpha,
            ordered_kw=ordered_kw,
            renewed=renewed_in,
            revert_kw=reverts_to_kw,
            cycle=cycle,
        )

    def first_held(self, mpp_kw: Floats, dispatch_kw: float) -> tuple[Floats, Floats]:
        """Return alpha and limit with which inverters hold their shares of the first dispatch."""
        plant_kw = total(self.sharing_kw.tolist())
        share_kw = self.sharing_kw * (usable_dispatch_kw(dispatch_kw, plant_kw) / plant_kw)
        alpha = np.divide(share_kw, mpp_kw, out=np.ones_like(mpp_kw), where=mpp_kw > share_kw)
        return alpha, share_kw if self._limits else self.rating_kw

    def power_kw(self, state: PlantState, mpp_kw: Floats) -> Floats:
        """Return what each inverter delivers [kW].

        The paper's inverter gives the share alpha of its maximum, cloud by cloud. A real one holds
        a power limit in its own fast loop (SunSpec model 123, `WMaxLimPct`).
        """
        share = np.ones_like(state.alpha) if self._limits else state.alpha
        return np.minimum(share * mpp_kw, state.limit_kw)


def stated_kw(mpp_kw: Floats, rating_kw: Floats, site: Site) -> Floats:
    """Return the available power that inverters state [kW], in the shape of their maxima.

    NaN: one states none.
    """
    if site.available_bias is None:
        return np.full_like(mpp_kw, np.nan)
    # 28 % of 25 inverters are 7, though 25 * 0.28 is a little more than that.
    stating = np.ceil(np.round(np.arange(len(rating_kw) + 1) * site.available_share, 9))
    is_stated = np.diff(stating) > 0.0
    power_kw = np.minimum(mpp_kw * (1.0 + site.available_bias), rating_kw)
    return np.where(is_stated, power_kw, np.nan)


def _ordered(now: list[float], before: Floats, passed: int) -> Floats:
    """Put what is ordered now before what was ordered until some cycles ago."""
    meanwhile = [before[:1]] * min(passed - 1, len(before))
    return np.vstack([[now], *meanwhile, before])[: len(before)]


def limit_towards(wanted_kw: Power, now_kw: Power, power_kw: Power, step_kw: Power) -> Power:
    """Return the limit in force; it falls from the power that it holds back, not from above."""
    before_kw: Power = np.minimum(now_kw, np.maximum(power_kw, wanted_kw))
    return towards(wanted_kw, before_kw, step_kw)


def towards(wanted: Power, now: Power, step: Power) -> Power:
    """Return what is wanted, as far as a step from now reaches. Also compiled, for one inverter."""
    reached: Power = np.minimum(np.maximum(wanted, now - step), now + step)
    return reached
