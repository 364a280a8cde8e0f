"""The plant: inverters under moving clouds, and the operator's dispatch, as one more agent.

begin    on the clock            -> telemetry of the interval that ended, dispatch for the next
advance  command of each inverter -> production: what really happened in the interval
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from agents.agent import Stage, Turn
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Dispatch, Message, Production, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, ControlTree
from sim_plant.inverter import delivered_power_kw
from sim_plant.profile import Profile


@dataclass(frozen=True, slots=True)
class PlantState:
    """What each inverter applied and delivered in the last interval, shape (n,)."""

    alpha: NDArray[np.float64]
    power_kw: NDArray[np.float64]


class Plant:
    """All inverters of a plant, and the operator who dispatches it.

    Parameters
    ----------
    tree
        Control tree; its leaves are the inverters.
    profile
        What sun and market do. Before the run begins the inverters stand under the first sample,
        uncurtailed.
    """

    name = PLANT

    def __init__(self, tree: ControlTree, profile: Profile) -> None:
        self._profile = profile
        self._telemetry = tuple(TELEMETRY.of(leaf) for leaf in tree.leaves)
        self._commands = tuple(COMMAND.of(leaf) for leaf in tree.leaves)
        self._dispatch = DISPATCH.of(ROOT)
        self._production = PRODUCTION.of(ROOT)
        self._stages = (
            Stage("begin", frozenset(), timed=True),
            Stage("advance", frozenset(self._commands)),
        )

    def initial_state(self) -> PlantState:
        """Every inverter at its maximum under the first sample."""
        first_kw = self._profile.mpp_kw[0]
        return PlantState(np.ones_like(first_kw), first_kw)

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages, the same in each cycle."""
        return self._stages

    def follow_up(self, port: Port[Message], message: Message) -> None:
        """Nothing that it hears announces anything else."""

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        """Close a stage."""
        if turn.stage == "begin":
            return state, self._begin(state, turn)
        return self._advance(state, turn)

    def _begin(self, state: PlantState, turn: Turn) -> list[Delivery]:
        commitment_kw = float(self._profile.commitment_kw[max(turn.cycle, 0)])
        dispatch = Dispatch(
            *turn.stamp, power_kw=commitment_kw, commitment_kw=commitment_kw, regulation_kw=0.0
        )
        outputs: list[Delivery] = [(self._dispatch, dispatch)]
        for port, power_kw, alpha in zip(
            self._telemetry, state.power_kw.tolist(), state.alpha.tolist(), strict=True
        ):
            outputs.append((port, Telemetry(*turn.stamp, power_kw=power_kw, alpha=alpha)))
        return outputs

    def _advance(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        alpha = np.array(
            [
                _applied_alpha(turn.get(port), last)
                for port, last in zip(self._commands, state.alpha.tolist(), strict=True)
            ]
        )
        cycle = max(turn.cycle, 0)
        mpp_kw = self._profile.mpp_kw[cycle]
        power_kw = delivered_power_kw(mpp_kw, alpha)
        production = Production(
            *turn.stamp,
            desired_kw=float(self._profile.commitment_kw[cycle]),
            possible_kw=float(mpp_kw.sum()),
            delivered_kw=float(power_kw.sum()),
            inverter_mpp_kw=tuple(mpp_kw.tolist()),
            inverter_power_kw=tuple(power_kw.tolist()),
        )
        return PlantState(alpha, power_kw), [(self._production, production)]


def _applied_alpha(command: Command | None, last: float) -> float:
    """Alpha that an inverter applies: the last one where the command is missing or absurd."""
    if command is None or not isfinite(command.alpha) or not 0.0 < command.alpha <= 1.0:
        return last
    return command.alpha
