"""All figures of merit of a run together."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from runs_by_hand import CYCLES_OF_15_HOURS, long_run, run_of

from studies.metrics import RunMetrics, run_metrics

POWER = st.floats(0.0, 1000.0)
CYCLES = st.lists(st.tuples(POWER, POWER, st.floats(0.0, 1.0)), min_size=1, max_size=30)


def test_a_run_of_four_cycles_by_hand() -> None:
    run = run_of(
        commitment_kw=[100.0, 100.0, 100.0, 50.0],
        possible_kw=[150.0, 120.0, 30.0, 80.0],
        delivered_kw=[100.0, 90.0, 20.0, 70.0],
        cycle_s=1800.0,
    )
    found = run_metrics(replace(run, ramp_limit_percent_per_min=0.2))
    assert found.commitment.unsatisfied_kwh == pytest.approx(45.0)
    assert found.tracking.mae_kw == pytest.approx(27.5)  # (0 + 10 + 80 + 20) / 4
    assert found.support.total_kw == pytest.approx(160.0)  # 0, 10, 80, 0
    assert found.headroom.headroom_kwh == pytest.approx(50.0)  # (50 + 30 + 10 + 10) / 2
    assert found.headroom.ancillary_potential_kwh == pytest.approx(50.0)  # (50 + 20 + 30) / 2
    assert found.ramps is not None
    assert found.ramps.largest_down_kw_per_min == pytest.approx(70.0 / 30.0)
    assert found.ramps.minutes_above_limit == 1
    assert found.regulation is None


def test_regulation_is_desired_but_no_part_of_the_ancillary_potential() -> None:
    run = run_of(
        commitment_kw=[100.0, 100.0],
        possible_kw=[150.0, 150.0],
        delivered_kw=[120.0, 100.0],
        regulation_kw=[20.0, -20.0],
        capacity_kw=40.0,
        cycle_s=3600.0,
    )
    found = run_metrics(run)
    assert found.commitment.desired_kwh == pytest.approx(200.0)
    assert found.commitment.over_delivered_kwh == pytest.approx(20.0)
    assert found.headroom.ancillary_potential_kwh == pytest.approx(100.0)
    assert found.regulation is not None
    assert found.regulation.requests[0].fulfilled == 1


def test_all_of_it_can_be_written_as_json_and_read_back() -> None:
    second = np.arange(3600)
    signal_kw = 100.0 * np.sin(second / 40.0 + 0.1)
    run = run_of(
        np.full(3600, 400.0), 900.0, 400.0 + signal_kw, regulation_kw=signal_kw, capacity_kw=100.0
    )
    found = run_metrics(replace(run, ramp_limit_percent_per_min=10.0))
    text = msgspec.json.encode(found)
    assert msgspec.json.decode(text, type=RunMetrics) == found
    assert json.loads(text)["regulation"]["performance"]["hours"][0]["windows"] == 12


def test_fifteen_hours_of_regulation_are_scored_hour_by_hour() -> None:
    found = run_metrics(long_run())
    assert found.regulation is not None
    assert found.regulation.performance is not None
    hours = found.regulation.performance.hours
    assert [hour.begins[11:13] for hour in hours] == [f"{hour:02}" for hour in range(5, 20)]
    assert {hour.windows for hour in hours} == {12}
    assert found.regulation.requests[0].requests == CYCLES_OF_15_HOURS // 2
    # A response that is noise has nothing to do with the signal.
    assert found.regulation.performance.precision == 0.0
    assert not found.regulation.performance.passed


def test_a_run_without_cycles_is_refused() -> None:
    with pytest.raises(ValueError, match="the run has no cycle"):
        run_metrics(run_of([], [], []))


def test_a_cycle_without_its_power_does_not_count() -> None:
    found = run_metrics(run_of([1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, math.nan, 0.5]))
    assert found == run_metrics(run_of([1.0, 1.0], [1.0, 1.0], [1.0, 0.5]))


@settings(max_examples=50)
@given(CYCLES, st.sampled_from([1.0, 7.0, 60.0, 600.0]))
def test_energies_balance_in_every_run(
    cycles: list[tuple[float, float, float]], cycle_s: float
) -> None:
    commitment_kw, possible_kw, alpha = np.array(cycles).T
    run = run_of(commitment_kw, possible_kw, alpha * possible_kw, cycle_s=cycle_s)
    found = run_metrics(run)
    energy = found.commitment
    assert energy.desired_kwh - energy.delivered_kwh == pytest.approx(
        energy.unsatisfied_kwh - energy.over_delivered_kwh, abs=1e-6
    )
    assert energy.possible_kwh - energy.delivered_kwh == pytest.approx(
        found.headroom.headroom_kwh, abs=1e-6
    )
    missed_kwh = found.tracking.mae_kw * run.cycles * cycle_s / 3600.0
    assert missed_kwh == pytest.approx(energy.unsatisfied_kwh + energy.over_delivered_kwh, abs=1e-6)
