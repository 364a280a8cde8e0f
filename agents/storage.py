"""The direct controller of a storage.

estimate  telemetry, dispatch -> impp with what it can take, residual
actuate   setpoint            -> command (power, negative to charge)
"""

from __future__ import annotations

import msgspec

from agents.agent import Turn
from agents.control.storage import NO_ABILITY, Ability, StorageLaw, ability
from agents.direct import NEVER, LeafController
from agents.dispatch import own_report
from agents.plan_parts import Control
from bus_schemas.bounds import METER_TOLERANCE
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Telemetry


class StorageState(msgspec.Struct, frozen=True, gc=False):
    """The ability of its storage by the newest telemetry, and the age and cycle of that."""

    able: Ability
    stale_cycles: int
    telemetry_cycle: int


class StorageController(LeafController):
    """States what its storage can give and take, and turns a setpoint into a command.

    Its share of the dispatch is 0: without a setpoint the storage rests.
    """

    def __init__(self, node: str, law: StorageLaw, control: Control) -> None:
        super().__init__(node, control)
        self._law = law

    def initial_state(self) -> StorageState:
        return StorageState(NO_ABILITY, 0, NEVER)

    def step(self, state: StorageState, turn: Turn) -> tuple[StorageState, list[Delivery]]:
        if turn.stage == "estimate":
            return self._estimate(state, turn)
        return state, self._actuate(state, turn)

    def _estimate(self, state: StorageState, turn: Turn) -> tuple[StorageState, list[Delivery]]:
        telemetry = turn.get(self._telemetry)
        if telemetry is None or 0 <= telemetry.cycle <= state.telemetry_cycle:
            state = StorageState(state.able, state.stale_cycles + 1, state.telemetry_cycle)
        else:
            state = StorageState(self._ability(telemetry), 0, telemetry.cycle)
        able = state.able if state.stale_cycles <= self._control.hold_cycles else NO_ABILITY
        impp_kw, share_kw = able.discharge_kw, 0.0
        report = own_report(self.name, turn, impp_kw, state.stale_cycles, impp_kw - share_kw, able)
        return state, report

    def _ability(self, telemetry: Telemetry) -> Ability:
        """Return the ability of the storage; none if it does not state its energy."""
        energy_kwh = telemetry.energy_kwh
        most_kw = self._law.rating_kw * (1.0 + METER_TOLERANCE)
        if not isinstance(energy_kwh, float) or not abs(telemetry.power_kw) <= most_kw:
            return NO_ABILITY
        return ability(energy_kwh, telemetry.power_kw, self._law)

    def _actuate(self, state: StorageState, turn: Turn) -> list[Delivery]:
        """Command the setpoint; where the dispatch has expired too, let the storage revert."""
        setpoint = turn.get(self._setpoint)
        is_alone = setpoint is None and turn.get(self._dispatch) is None
        if is_alone or state.telemetry_cycle == NEVER:
            return []
        power_kw = 0.0 if setpoint is None else setpoint.power_kw
        command = Command(*turn.stamp, alpha=1.0, power_kw=power_kw, revert_kw=0.0)
        return [(self._command, command)]
