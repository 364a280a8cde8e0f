"""Ramps over a minute, worked out by hand, beside a limit."""

import numpy as np
import pytest

from studies.metrics.ramps import RampMetrics, ramp_metrics

RATING_KW = 1000.0


def test_a_ramp_is_the_change_over_a_minute_from_every_cycle_on() -> None:
    # Cycles of 20 s, so a minute is three: 150 - 100, 130 - 100, 10 - 120, 40 - 150, 40 - 130
    delivered_kw = np.array([100.0, 100.0, 120.0, 150.0, 130.0, 10.0, 40.0, 40.0])
    found = ramp_metrics(delivered_kw, RATING_KW, 20.0, limit_percent_per_min=10.0)
    assert found == RampMetrics(
        largest_up_kw_per_min=50.0,
        largest_down_kw_per_min=110.0,
        limit_kw_per_min=100.0,
        minutes=2,  # ramps that begin in cycles 0 to 2, and in 3 and 4
        minutes_above_limit=2,
        above_limit_percent=100.0,
    )


def test_only_the_minutes_with_a_ramp_above_the_limit_count() -> None:
    delivered_kw = np.concatenate([np.full(200, 500.0), np.full(100, 300.0)])
    found = ramp_metrics(delivered_kw, RATING_KW, 1.0, limit_percent_per_min=10.0)
    assert found is not None
    # 240 ramps, 4 minutes. Those that begin in cycles 140 to 199 end after the fall of 200 kW.
    assert (found.minutes, found.minutes_above_limit, found.above_limit_percent) == (4, 2, 50.0)


def test_a_ramp_exactly_at_the_limit_is_allowed() -> None:
    delivered_kw = 0.1 * RATING_KW / 60.0 * np.arange(300.0)
    found = ramp_metrics(delivered_kw, RATING_KW, 1.0, limit_percent_per_min=10.0)
    assert found is not None
    assert found.largest_up_kw_per_min == pytest.approx(100.0)
    assert (found.largest_down_kw_per_min, found.minutes_above_limit) == (0.0, 0)


def test_cycles_that_do_not_divide_a_minute_give_a_rate_per_minute() -> None:
    # The nearest to 60 s is two cycles of 25 s: 20 kW in 50 s
    found = ramp_metrics(np.array([0.0, 5.0, 20.0]), RATING_KW, 25.0)
    assert found is not None
    assert found.largest_up_kw_per_min == pytest.approx(24.0)
    # A cycle of two minutes: 20 kW in 120 s
    slow = ramp_metrics(np.array([0.0, 20.0]), RATING_KW, 120.0)
    assert slow is not None
    assert slow.largest_up_kw_per_min == pytest.approx(10.0)


def test_a_run_of_a_minute_or_less_has_no_ramp() -> None:
    assert ramp_metrics(np.zeros(60), RATING_KW, 1.0, limit_percent_per_min=10.0) is None
    assert ramp_metrics(np.zeros(61), RATING_KW, 1.0) is not None
