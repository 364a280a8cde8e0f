"""The direct controller: one at each inverter.

estimate  telemetry, dispatch -> impp, residual, help if the residual is negative
actuate   setpoint            -> command (alpha)
"""

from __future__ import annotations

from math import nan
from typing import Final

import msgspec

from agents.agent import Stage, Turn
from agents.control.forecast import Reading, forecast_impp, held_kw
from agents.control.impp import (
    NOTHING_KNOWN,
    Estimate,
    curtailment_level,
    estimate_impp,
    is_lost,
    stale,
)
from agents.dispatch import own_report, own_share_kw
from agents.plan_parts import Control
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, SETPOINT, TELEMETRY
from bus_schemas.tree import ROOT, parent_of

NEVER: Final = -(2**31)


class DirectState(msgspec.Struct, frozen=True, gc=False):
    """The estimate of the maximum, and the cycle of its newest telemetry."""

    estimate: Estimate
    telemetry_cycle: int


class LeafController:
    """Ports and stages of a direct controller, of an inverter or a storage."""

    may_skip = True

    def __init__(self, node: str, control: Control) -> None:
        self.name = node
        self._control = control
        self._parent = parent_of(node)
        self._telemetry = TELEMETRY.of(node)
        self._dispatch = DISPATCH.of(ROOT)
        self._setpoint = SETPOINT.of(node)
        self._command = COMMAND.of(node)
        estimate = Stage("estimate", (self._telemetry, self._dispatch))
        self._with_parent = (estimate, Stage("actuate", (self._setpoint,), (self._dispatch,)))
        self._alone = (estimate, Stage("actuate", (), (self._setpoint, self._dispatch)))

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages; between its parent's turns it waits for its device alone."""
        parent_acts = self._control.periods.acts(self._parent, cycle)
        return self._with_parent if parent_acts else self._alone


class DirectController(LeafController):
    """Estimates its inverter's maximum power, states its deficit, turns a setpoint into alpha."""

    def __init__(
        self, node: str, rating_kw: float, sharing_kw: float, control: Control, cycle_s: float
    ) -> None:
        super().__init__(node, control)
        self._rating_kw, self._sharing_kw = rating_kw, sharing_kw
        self._cycle_s = cycle_s

    def initial_state(self) -> DirectState:
        return DirectState(NOTHING_KNOWN, NEVER)

    def step(self, state: DirectState, turn: Turn) -> tuple[DirectState, list[Delivery]]:
        if turn.stage == "estimate":
            return self._estimate(state, turn)
        return state, self._actuate(state, turn)

    def _estimate(self, state: DirectState, turn: Turn) -> tuple[DirectState, list[Delivery]]:
        telemetry = turn.get(self._telemetry)
        if telemetry is not None and 0 <= telemetry.cycle <= state.telemetry_cycle:
            telemetry = None  # The estimate rests on it already.
        last = state.estimate
        if telemetry is not None and telemetry.cycle > state.telemetry_cycle + 1:
            last = last._replace(is_seen=False)  # After a gap its change tells no trend.
        estimate = self._estimate_now(telemetry, last)
        share_kw = own_share_kw(turn.get(self._dispatch), self._sharing_kw)
        impp_kw = estimate.power_kw
        # Where the dispatch has expired too, it is the plant that is not heard.
        if share_kw is not None and is_lost(estimate, self._control.hold_cycles):
            impp_kw = 0.0
        residual_kw = impp_kw - (share_kw or 0.0)
        outputs = own_report(self.name, turn, impp_kw, estimate.stale_cycles, residual_kw)
        measured = state.telemetry_cycle if telemetry is None else telemetry.cycle
        return DirectState(estimate, measured), outputs

    def _estimate_now(self, telemetry: Telemetry | None, last: Estimate) -> Estimate:
        if telemetry is None:
            return stale(last)
        power_kw, alpha, rating_kw = telemetry.power_kw, telemetry.alpha, self._rating_kw
        available_kw = nan if telemetry.available_kw is None else telemetry.available_kw
        if self._control.scheme == "paper":
            return estimate_impp(power_kw, alpha, available_kw, rating_kw, last)
        if self._control.actuator == "limit":
            alpha = 1.0  # It holds its limit, and gives all it has below it.
        reading = Reading(power_kw, alpha, available_kw, telemetry.limit_kw)
        return forecast_impp(reading, rating_kw, self._cycle_s, last)

    def _actuate(self, state: DirectState, turn: Turn) -> list[Delivery]:
        """Command the setpoint; without one the inverter's own share of the dispatch.

        Where the dispatch has expired too, nothing is sent: the inverter decides for itself. Nor is
        anything before the first telemetry, since that would wipe a limit which the inverter has.
        An inverter that is lost has a setpoint of 0 kW: it is commanded its share instead, so that
        it shows itself if it lives.
        """
        if state.telemetry_cycle == NEVER:
            return []
        setpoint = turn.get(self._setpoint)
        share_kw = own_share_kw(turn.get(self._dispatch), self._sharing_kw)
        lost = share_kw is not None and is_lost(state.estimate, self._control.hold_cycles)
        target_kw = share_kw if setpoint is None or lost else setpoint.power_kw
        if target_kw is None:
            return []
        impp_kw = state.estimate.power_kw
        alpha = curtailment_level(target_kw, impp_kw, self._control.alpha_floor)
        power_kw = alpha * impp_kw if alpha < 1.0 else self._rating_kw
        if lost:
            power_kw = target_kw
        elif alpha == 1.0 and self._control.holds_limits:
            power_kw = held_kw(target_kw, self._rating_kw, state.estimate)
        command = Command(*turn.stamp, alpha=alpha, power_kw=power_kw, revert_kw=share_kw)
        return [(self._command, command)]
