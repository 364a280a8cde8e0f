"""All figures of merit of a run together, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from runs_by_hand import RATING_KW, run_of, sine_of_an_hour

from recordings.read.series import RunSeries
from results.metrics import CommitmentMetrics, commitment_metrics, run_metrics
from results.metrics.run import RampMetrics, ramp_metrics


def test_a_run_of_four_half_hours_by_hand() -> None:
    run = run_of(
        #             met    short  dark   over
        commitment_kw=[100.0, 100.0, 100.0, 50.0],
        available_kw=[150.0, 120.0, 30.0, 80.0],
        delivered_kw=[100.0, 90.0, 20.0, 70.0],
        cycle_s=1800.0,
    )
    found = run_metrics(replace(run, ramp_limit_percent_per_min=0.2))
    assert found.commitment == CommitmentMetrics(
        dispatched_kwh=175.0,  # (100 + 100 + 100 + 50) / 2
        available_kwh=190.0,  # (150 + 120 + 30 + 80) / 2
        delivered_kwh=140.0,  # (100 + 90 + 20 + 70) / 2
        shortfall_kwh=45.0,  # (0 + 10 + 80 + 0) / 2
        unavoidable_kwh=35.0,  # (0 + 0 + 70 + 0) / 2
        control_caused_kwh=10.0,  # (0 + 10 + 10 + 0) / 2
        over_delivered_kwh=10.0,  # (0 + 0 + 0 + 20) / 2
    )
    assert found.commitment.satisfied_percent == pytest.approx(100.0 * (1.0 - 45.0 / 175.0))
    assert found.tracking.mae_kw == pytest.approx(27.5)  # (0 + 10 + 80 + 20) / 4
    assert found.tracking.rmse_kw == pytest.approx(np.sqrt(6900.0 / 4.0))
    assert found.mileage.total_kw == pytest.approx(160.0)  # 0, 10, 80, 0
    assert found.mileage.per_hour_kw == pytest.approx(80.0)
    assert found.mileage.per_minute_kw == pytest.approx(80.0 / 60.0)
    assert found.headroom.curtailed_kwh == pytest.approx(50.0)  # (50 + 30 + 10 + 10) / 2
    assert found.headroom.mean_headroom_kw == pytest.approx(25.0)
    assert found.headroom.ancillary_potential_kwh == pytest.approx(50.0)  # (50 + 20 + 30) / 2
    assert found.ramps is not None
    assert found.ramps.largest_kw_per_min == pytest.approx(70.0 / 30.0)
    assert found.ramps.above_limit_percent == pytest.approx(100.0 / 3.0)
    assert found.regulation is None


def test_a_ramp_is_the_change_over_a_minute_from_every_cycle_on() -> None:
    # Cycles of 20 s, so a minute is three: 150 - 100, 130 - 100, 10 - 120, 40 - 150, 40 - 130
    delivered_kw = np.array([100.0, 100.0, 120.0, 150.0, 130.0, 10.0, 40.0, 40.0])
    found = ramp_metrics(delivered_kw, RATING_KW, 20.0, limit_percent_per_min=10.0)
    # Minutes of ramps that begin in cycles 0 to 2, and in 3 and 4.
    assert found == RampMetrics(50.0, 110.0, 100.0, 100.0)


@pytest.mark.parametrize(
    ("delivered_kw", "percent"),
    [
        # 240 ramps in 4 minutes. Those of cycles 140 to 199 end after the fall of 200 kW.
        (np.repeat([500.0, 300.0], [200, 100]), 50.0),
        # A ramp exactly at the limit is allowed.
        (0.1 * RATING_KW / 60.0 * np.arange(300.0), 0.0),
    ],
)
def test_only_the_minutes_with_a_ramp_above_the_limit_count(
    delivered_kw: np.ndarray, percent: float
) -> None:
    found = ramp_metrics(delivered_kw, RATING_KW, 1.0, limit_percent_per_min=10.0)
    assert found is not None
    assert found.above_limit_percent == percent


@pytest.mark.parametrize(
    ("delivered_kw", "cycle_s", "largest"),
    [
        ([0.0, 5.0, 20.0], 25.0, 24.0),  # The nearest to 60 s is two cycles: 20 kW in 50 s.
        ([0.0, 20.0], 120.0, 10.0),
        ([0.0] * 60 + [7.0], 1.0, 7.0),
        ([0.0] * 60, 1.0, None),  # A minute or less has no ramp.
    ],
)
def test_a_ramp_is_a_rate_per_minute(
    delivered_kw: list[float], cycle_s: float, largest: float | None
) -> None:
    found = ramp_metrics(np.array(delivered_kw), RATING_KW, cycle_s, limit_percent_per_min=10.0)
    assert (found and found.largest_up_kw_per_min) == pytest.approx(largest)


def test_regulation_is_desired_but_no_part_of_the_ancillary_potential() -> None:
    run = run_of(
        commitment_kw=[100.0, 100.0],
        available_kw=[150.0, 150.0],
        delivered_kw=[120.0, 100.0],
        regulation_kw=[20.0, -20.0],
        capacity_kw=40.0,
        cycle_s=3600.0,
    )
    found = run_metrics(run)
    assert found.commitment.dispatched_kwh == pytest.approx(200.0)
    assert found.commitment.over_delivered_kwh == pytest.approx(20.0)
    assert found.headroom.ancillary_potential_kwh == pytest.approx(100.0)
    assert found.regulation is not None
    assert found.regulation.requests[0].fulfilled == 1


def test_where_nothing_was_desired_no_share_of_it_is_defined() -> None:
    found = commitment_metrics([0.0, 0.0], [10.0, 10.0], [5.0, 5.0], 3600.0)
    assert (found.satisfied_percent, found.percent(found.over_delivered_kwh)) == (None, None)


def without(run: RunSeries, cycles: slice, *fields: str) -> RunSeries:
    """Return a run as read from a recording that lacks messages of some cycles."""
    arrays = {field: getattr(run, field).copy() for field in fields}
    for values in arrays.values():
        values[cycles] = np.nan
    return replace(run, **arrays)


DISPATCH = ("commitment_kw", "regulation_kw")
PRODUCTION = ("mpp_kw", "power_kw")


@pytest.mark.parametrize("fields", [DISPATCH, PRODUCTION, DISPATCH + PRODUCTION])
def test_cycles_with_a_message_missing_do_not_count(fields: tuple[str, ...]) -> None:
    whole = run_metrics(sine_of_an_hour(response=0.75))
    found = run_metrics(without(sine_of_an_hour(response=0.75), slice(900, 910), *fields))
    assert found.commitment.available_kwh == pytest.approx(
        whole.commitment.available_kwh * 3590 / 3600
    )
    assert found.ramps is not None
    assert whole.ramps is not None
    assert found.ramps.largest_kw_per_min == pytest.approx(whole.ramps.largest_kw_per_min)
    assert found.regulation is not None
    assert found.regulation.requests[0].requests == 1795
    assert found.regulation.performance is not None
    # The window from 12:15 on has a gap, and the clock of the others does not move.
    assert [hour.windows for hour in found.regulation.performance.hours] == [11]
    assert found.regulation.performance.precision == pytest.approx(0.75)


@pytest.mark.parametrize("fields", [(), PRODUCTION])
def test_a_run_without_a_known_cycle_is_refused(fields: tuple[str, ...]) -> None:
    run = without(run_of([1.0], [1.0], [1.0]), slice(None), *fields) if fields else run_of([], 1, 1)
    with pytest.raises(ValueError, match="expected a cycle with dispatch and production, got none"):
        run_metrics(run)
