"""Every number in a state is altered, wherever it stands, and the state keeps its form."""

from __future__ import annotations

import numpy as np
from troubled_runs import cloudy_profile, plan_of

from agents.central import CentralState
from agents.control.impp import ImppEstimate
from agents.direct import DirectState
from agents.family import Report
from launch_scripts.verification.altered_state import altered_states
from sim_plant.plant import Plant, PlantState


def test_numbers_are_altered_in_structs_and_tuples_at_any_depth() -> None:
    reports = (Report(1.0, -2.0, 3, 4, 5), Report(0.0, 0.0, 0, 0, 0))
    state = CentralState(True, 5.0, 6.0, 7, reports)
    less, more = altered_states(state)
    nothing = Report(0.0, 0.0, 0, 0, 0)
    assert less == CentralState(False, 0.0, 0.0, 0, (nothing, nothing))
    assert more.dispatched
    assert more.reports[0] == Report(1002.0, 996.0, 1006, 1008, 1010)
    assert isinstance(more.reports[0].silent_cycles, int)


def test_a_named_tuple_stays_one() -> None:
    _, more = altered_states(DirectState(ImppEstimate(10.0, 0), 20.0, 30.0))
    assert isinstance(more.impp, ImppEstimate)
    assert (more.impp.power_kw, more.impp.stale_cycles, more.setpoint_kw) == (1020.0, 1000, 1060.0)


def test_arrays_in_dataclasses_are_altered_and_the_state_itself_is_not() -> None:
    plan = plan_of()
    state = Plant(plan.tree, cloudy_profile(plan)).initial_state()
    alpha = state.alpha.copy()
    _, more = altered_states(state)
    assert isinstance(more, PlantState)
    assert np.array_equal(more.alpha, 2 * alpha + 1000)
    assert np.array_equal(state.alpha, alpha)
