"""The plant: inverters under moving clouds, and the operator's dispatch, as one more agent.

begin    on the clock            -> telemetry of the interval that ended, dispatch for the next
advance  command of each inverter -> production: what really happened in the interval
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from agents.agent import Stage, Turn
from agents.plan import Actuator
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Dispatch, Message, Production, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, PRODUCTION, TELEMETRY, Port
from bus_schemas.tree import PLANT, ROOT, ControlTree
from sim_plant.inverter import delivered_power_kw
from sim_plant.profile import Profile


@dataclass(frozen=True, slots=True)
class PlantState:
    """What each inverter obeyed and delivered in the last interval, shape (n,)."""

    alpha: NDArray[np.float64]
    limit_kw: NDArray[np.float64]
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
    actuator
        What the inverters do with a command.
    """

    name = PLANT

    def __init__(
        self, tree: ControlTree, profile: Profile, actuator: Actuator = "fraction"
    ) -> None:
        self._profile = profile
        self._actuator = actuator
        self._rating_kw = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
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
        return PlantState(np.ones_like(first_kw), self._rating_kw, first_kw)

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
        cycle = max(turn.cycle, 0)
        commitment_kw = float(self._profile.commitment_kw[cycle])
        regulation_kw = float(self._profile.regulation_kw[cycle])
        dispatch = Dispatch(
            *turn.stamp,
            power_kw=commitment_kw + regulation_kw,
            commitment_kw=commitment_kw,
            regulation_kw=regulation_kw,
        )
        outputs: list[Delivery] = [(self._dispatch, dispatch)]
        measured_kw = state.power_kw * (1.0 + self._profile.meter_error[cycle])
        for port, power_kw, alpha, limit_kw in zip(
            self._telemetry,
            measured_kw.tolist(),
            state.alpha.tolist(),
            state.limit_kw.tolist(),
            strict=True,
        ):
            telemetry = Telemetry(*turn.stamp, power_kw=power_kw, alpha=alpha, limit_kw=limit_kw)
            outputs.append((port, telemetry))
        return outputs

    def _advance(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        cycle = max(turn.cycle, 0)
        mpp_kw = self._profile.mpp_kw[cycle]
        alpha, limit_kw = self._obeyed(state, turn)
        share = alpha if self._actuator == "fraction" else np.ones_like(alpha)
        power_kw = delivered_power_kw(mpp_kw, share, limit_kw)
        production = Production(
            *turn.stamp,
            desired_kw=float(
                self._profile.commitment_kw[cycle] + self._profile.regulation_kw[cycle]
            ),
            possible_kw=float(mpp_kw.sum()),
            delivered_kw=float(power_kw.sum()),
            inverter_mpp_kw=tuple(mpp_kw.tolist()),
            inverter_power_kw=tuple(power_kw.tolist()),
        )
        return PlantState(alpha, limit_kw, power_kw), [(self._production, production)]

    def _obeyed(
        self, state: PlantState, turn: Turn
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Alpha and limit of each inverter: the last ones where a command is missing or absurd."""
        alpha, limit_kw = state.alpha.tolist(), state.limit_kw.tolist()
        for place, port in enumerate(self._commands):
            command = turn.get(port)
            if command is not None and _makes_sense(command):
                alpha[place] = command.alpha
                if self._actuator == "limit":
                    limit_kw[place] = min(command.power_kw, self._rating_kw[place])
        return np.array(alpha), np.array(limit_kw)


def _makes_sense(command: Command) -> bool:
    # NaN fails every comparison.
    return 0.0 < command.alpha <= 1.0 and 0.0 <= command.power_kw < inf
