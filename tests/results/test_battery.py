"""The smallest battery by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs_by_hand import run_of

from results.battery import smallest_battery
from results.figures import run_figures

HOUR_S = 3600.0


def test_a_battery_gives_what_is_missing_and_is_charged_from_headroom() -> None:
    #            lacks 10, then 20; charged with 20 at most; lacks 15
    missing = np.array([0.0, 10.0, 20.0, 0.0, 0.0, 15.0])
    headroom = np.array([50.0, 0.0, 0.0, 5.0, 50.0, 0.0])
    found = smallest_battery(missing, headroom, HOUR_S, efficiency=1.0)
    assert found.power_kw == 20.0
    # 30 kWh are gone after three hours, 5 and 20 come back, and 15 are added: 20.
    assert found.energy_kwh == 30.0
    assert found.cycles == pytest.approx(45.0 / 30.0)
    # Its power: 0, 10, 20, -5, -20, 15.
    assert found.mileage_kw == 10 + 10 + 25 + 15 + 35


@given(
    st.lists(st.tuples(st.floats(0, 100), st.floats(0, 100)), min_size=1, max_size=30),
    st.floats(0.5, 1.0),
)
def test_a_battery_of_that_size_is_never_empty_and_a_smaller_one_is(
    cycles: list[tuple[float, float]], efficiency: float
) -> None:
    missing, headroom = np.array(cycles).T
    headroom = np.where(missing > 0.0, 0.0, headroom)
    found = smallest_battery(missing, headroom, HOUR_S, efficiency)

    def lowest(capacity_kwh: float) -> float:
        state, least = capacity_kwh, capacity_kwh
        for out_kw, in_kw in zip(missing, headroom, strict=True):
            state -= out_kw / efficiency**0.5
            least = min(least, state)
            state = min(capacity_kwh, state + min(in_kw, found.power_kw) * efficiency**0.5)
        return least

    assert lowest(found.energy_kwh) >= -1e-9
    if found.energy_kwh > 1e-3:
        assert lowest(0.99 * found.energy_kwh) < 0.0


def test_a_run_says_which_battery_it_would_need_and_which_one_without_help() -> None:
    run = run_of([100.0] * 4, [150.0, 90.0, 150.0, 150.0], [100.0, 80.0, 100.0, 100.0], cycle_s=900)
    found = run_figures(run)
    assert found["battery-power"] == pytest.approx(20.0)
    assert found["battery-energy"] == pytest.approx(5.0 / 0.85**0.5)
    assert found["control-battery-power"] == pytest.approx(10.0)
    assert found["battery-cycles"] == pytest.approx(1.0)
    assert found["without-help-battery-power"] is not None
