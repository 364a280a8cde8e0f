"""The direct controller: one at each inverter.

estimate  telemetry, request -> impp, residual, help if the residual is negative
actuate   setpoint           -> command (alpha)
"""

from __future__ import annotations

from math import nan

import msgspec

from agents.agent import Stage, Turn, parents_word_kw
from agents.control.curtailment import curtailment_level
from agents.control.forecast import HIDDEN_ALPHA_MIN, forecast_impp
from agents.control.impp import NOTHING_KNOWN, Estimate, estimate_impp
from agents.control.request import residual_kw
from agents.periods import Periods
from agents.plan import Actuator, Scheme
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Help, Impp, Message, Residual, Telemetry
from bus_schemas.signals import (
    COMMAND,
    HELP,
    IMPP,
    REQUEST,
    RESIDUAL,
    SETPOINT,
    TELEMETRY,
    Port,
)
from bus_schemas.tree import parent_of


class DirectState(msgspec.Struct, frozen=True, gc=False):
    """What a direct controller remembers: its estimate, and its parent's last words [kW].

    Before the first setpoint there is nothing to hold back: it is the rating.
    """

    impp: Estimate
    request_kw: float
    setpoint_kw: float


class DirectController:
    """Estimates its inverter's maximum power, says what it lacks, turns a setpoint into alpha.

    Parameters
    ----------
    node
        Path of the inverter in the control tree.
    rating_kw
        AC rating of the inverter.
    alpha_min
        Lowest alpha it commands, so that the maximum can be measured through it.
    periods
        In which cycles its parent speaks.
    scheme
        How it estimates the maximum.
    actuator
        What the inverter does with a command.
    """

    def __init__(
        self,
        node: str,
        rating_kw: float,
        alpha_min: float,
        periods: Periods,
        scheme: Scheme,
        actuator: Actuator,
    ) -> None:
        self.name = node
        self.rating_kw = rating_kw
        hides = scheme == "predictive" and actuator == "limit"
        self.alpha_min = HIDDEN_ALPHA_MIN if hides else alpha_min
        self.scheme = scheme
        self.actuator = actuator
        self._periods = periods
        self._telemetry = TELEMETRY.of(node)
        self._request = REQUEST.of(node)
        self._setpoint = SETPOINT.of(node)
        self._impp = IMPP.of(node)
        self._residual = RESIDUAL.of(node)
        self._help = HELP.of(node)
        self._command = COMMAND.of(node)
        self._full_cycle = (
            Stage("estimate", frozenset({self._telemetry, self._request})),
            Stage("actuate", frozenset({self._setpoint})),
        )
        self._own_cycle = (
            Stage(
                "estimate",
                frozenset({self._telemetry}),
                takes_late=frozenset({self._request}),
            ),
            Stage("actuate", frozenset(), takes_late=frozenset({self._setpoint})),
        )

    def initial_state(self) -> DirectState:
        """Nothing measured, nothing asked. A forecast has no last measurement to go on from."""
        return DirectState(NOTHING_KNOWN, 0.0, self.rating_kw)

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages; between its parent's turns it waits for its inverter alone."""
        parent_acts = self._periods.is_turn(parent_of(self.name), cycle)
        return self._full_cycle if parent_acts else self._own_cycle

    def follow_up(self, port: Port[Message], message: Message) -> None:
        """Nothing that it hears announces anything else."""

    def step(self, state: DirectState, turn: Turn) -> tuple[DirectState, list[Delivery]]:
        """Close a stage."""
        if turn.stage == "estimate":
            return self._estimate(state, turn)
        return self._actuate(state, turn)

    def _estimate(self, state: DirectState, turn: Turn) -> tuple[DirectState, list[Delivery]]:
        impp = self._impp_now(turn.get(self._telemetry), state.impp)
        request_kw = parents_word_kw(turn.get(self._request), state.request_kw, self.rating_kw)
        residual = residual_kw(impp.power_kw, request_kw)
        outputs: list[Delivery] = [
            (
                self._impp,
                Impp(*turn.stamp, power_kw=impp.power_kw, stale_cycles=impp.stale_cycles),
            ),
            (self._residual, Residual(*turn.stamp, power_kw=residual)),
        ]
        if residual < 0.0:
            outputs.append((self._help, Help(*turn.stamp, missing_kw=-residual)))
        return DirectState(impp, request_kw, state.setpoint_kw), outputs

    def _impp_now(self, telemetry: Telemetry | None, last: Estimate) -> Estimate:
        power_kw = telemetry.power_kw if telemetry else nan
        alpha = telemetry.alpha if telemetry else nan
        if self.scheme == "paper":
            return estimate_impp(power_kw, alpha, nan, self.rating_kw, last)
        limit_kw = telemetry.limit_kw if telemetry else self.rating_kw
        if self.actuator == "limit":
            alpha = 1.0  # It holds its limit, and gives all it has below it.
        return forecast_impp(power_kw, alpha, nan, limit_kw, self.rating_kw, 1.0, last)

    def _actuate(self, state: DirectState, turn: Turn) -> tuple[DirectState, list[Delivery]]:
        setpoint_kw = parents_word_kw(turn.get(self._setpoint), state.setpoint_kw, self.rating_kw)
        impp_kw = state.impp.power_kw
        alpha = curtailment_level(setpoint_kw, impp_kw, self.alpha_min)
        power_kw = alpha * impp_kw if alpha < 1.0 else self.rating_kw
        command = Command(*turn.stamp, alpha=alpha, power_kw=power_kw)
        return DirectState(state.impp, state.request_kw, setpoint_kw), [(self._command, command)]
