"""What a parent with a meter knows of it, and how it corrects its target by that."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan, sqrt
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from agents.agent import Turn
from agents.control.correction import (
    Correction,
    CorrectionLaw,
    corrected,
    corrected_kw,
    with_reading,
)
from agents.control.grid import GridLaw
from bus_schemas.messages import Memory, Meter


class MeterState(msgspec.Struct, frozen=True, gc=False):
    """What a parent remembers of its meter.

    correction: What it has learned of it.
    meter_cycle: Cycle of its newest reading.
    reference_kw: What is wanted, within the ramp limits; NaN: there was nothing yet.
    """

    correction: Correction
    meter_cycle: int = 0
    reference_kw: float = nan


_State = TypeVar("_State", bound=MeterState)


@dataclass(frozen=True, slots=True)
class Feedback:
    """Corrects a target by a meter, within what the grid asks there."""

    law: CorrectionLaw
    grid: GridLaw

    def recalled(self, state: _State, meter: Meter | None) -> _State:
        """Go on, in a new process, from what the one before it stated last."""
        is_new = state.meter_cycle == 0 and isnan(state.reference_kw)
        if meter is None or meter.correction_kw is None or not is_new:
            return state
        kept = len(state.correction.shown_kw)
        shown_kw = (*(nan if kw is None else kw for kw in meter.expected_kw), *((nan,) * kept))
        tried_kw2 = (meter.tried_kw or 0.0) ** 2
        correction = state.correction._replace(
            shown_kw=shown_kw[:kept],
            lacking_kw=meter.lacking_kw or 0.0,
            correction_kw=meter.correction_kw,
            helped_kw2=(meter.helped_share or 0.0) * tried_kw2,
            tried_kw2=tried_kw2,
            error_kw=meter.error_kw or 0.0,
        )
        reference_kw = nan if meter.reference_kw is None else meter.reference_kw
        return replace(state, correction=correction, reference_kw=reference_kw)

    def read(self, state: _State, meter: Meter | None) -> _State:
        """Take up the meter's newest reading, each reading once."""
        if meter is None or meter.cycle <= state.meter_cycle:
            return state
        correction = with_reading(state.correction, meter.power_kw)
        return replace(state, meter_cycle=meter.cycle, correction=correction)

    def target_kw(
        self, state: _State, wanted_kw: float, possible_kw: float, late_cycles: int
    ) -> tuple[_State, float]:
        """Return what inverters and storages are to give for a power at the meter.

        `late_cycles` is the age of the reports. The setpoints' way down is assumed to take as long
        as their way up.
        """
        delay_s = late_cycles * self.law.cycle_s
        correction = corrected(state.correction, wanted_kw, possible_kw, delay_s, self.law)
        state = replace(state, correction=correction)
        return state, corrected_kw(correction, self.law, self.grid)

    def memory(self, state: MeterState, turn: Turn) -> Memory:
        known = state.correction
        return Memory(
            *turn.stamp,
            correction_kw=known.correction_kw,
            error_kw=known.error_kw,
            expected_kw=tuple(None if isnan(kw) else kw for kw in known.shown_kw),
            reference_kw=None if isnan(state.reference_kw) else state.reference_kw,
            lacking_kw=known.lacking_kw,
            tried_kw=sqrt(known.tried_kw2),
            helped_share=known.helped_kw2 / known.tried_kw2 if known.tried_kw2 > 0.0 else 0.0,
        )
