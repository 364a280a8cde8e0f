"""The IMPP as a forecast: trend, margin, and what is assumed of a maximum that is hidden."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control.forecast import (
    BOUND_TOLERANCE,
    DAMPING,
    ERROR_MEMORY_CYCLES,
    HIDDEN_GROWTH,
    LOW_READING_SAFETY,
    MARGIN,
    NOTHING_KNOWN,
    forecast_impp,
)
from agents.control.impp import ImppEstimate

RATING_KW = 100.0


def measured(*maxima_kw: float) -> ImppEstimate:
    """The forecast after these maxima were measured, one a cycle, on a free inverter."""
    estimate = NOTHING_KNOWN
    for maximum_kw in maxima_kw:
        estimate = forecast_impp(maximum_kw, 1.0, RATING_KW, RATING_KW, estimate)
    return estimate


def test_the_first_measurement_has_no_trend_and_no_known_error() -> None:
    assert measured(40.0)[:5] == (40.0, 0, 40.0, 40.0, 0.0)


def test_the_last_change_is_expected_to_go_on_damped_and_the_own_error_is_taken_off_in_part() -> (
    None
):
    found = measured(40.0, 50.0)
    spread_kw = 10.0 / ERROR_MEMORY_CYCLES
    assert found.expected_kw == pytest.approx(50.0 + DAMPING * 10.0)
    assert found.spread_kw == pytest.approx(spread_kw)
    assert found.power_kw == pytest.approx(59.0 - MARGIN * spread_kw)


def test_a_steady_sky_is_trusted_in_full() -> None:
    assert measured(*[70.0] * 5).power_kw == 70.0


def test_the_maximum_is_read_through_the_fraction_applied() -> None:
    assert forecast_impp(30.0, 0.6, RATING_KW, RATING_KW, NOTHING_KNOWN).measured_kw == 50.0


def test_a_maximum_behind_a_limit_is_assumed_to_grow_from_the_last_one_seen() -> None:
    seen = measured(60.0)
    hidden = forecast_impp(40.0, 1.0, 40.0, RATING_KW, seen)
    assert hidden.power_kw == pytest.approx(60.0 * (1.0 + HIDDEN_GROWTH))
    assert hidden.stale_cycles == 1
    longer = forecast_impp(40.0, 1.0, 40.0, RATING_KW, hidden)
    assert longer.power_kw == pytest.approx(60.0 * (1.0 + HIDDEN_GROWTH) ** 2)


def test_a_limit_that_is_held_shows_that_there_is_at_least_as_much() -> None:
    hidden = forecast_impp(80.0, 1.0, 80.0, RATING_KW, measured(60.0))
    assert hidden.power_kw == pytest.approx(80.0 * (1.0 + HIDDEN_GROWTH))


def test_what_is_assumed_never_exceeds_the_rating() -> None:
    estimate = measured(99.0)
    for _ in range(10):
        estimate = forecast_impp(50.0, 1.0, 50.0, RATING_KW, estimate)
    assert estimate.power_kw == RATING_KW


def test_an_inverter_that_falls_below_its_limit_shows_its_maximum_again_without_a_trend() -> None:
    hidden = forecast_impp(40.0, 1.0, 40.0, RATING_KW, measured(60.0))
    shown = forecast_impp(30.0, 1.0, 40.0, RATING_KW, hidden)
    assert (shown.measured_kw, shown.expected_kw, shown.stale_cycles) == (30.0, 30.0, 0)


def test_a_meter_that_reads_a_little_below_the_limit_is_still_held_by_it() -> None:
    near_kw = 40.0 * (1.0 - BOUND_TOLERANCE / 2)
    assert forecast_impp(near_kw, 1.0, 40.0, RATING_KW, measured(60.0)).stale_cycles == 1


@pytest.mark.parametrize(
    ("power_kw", "alpha"), [(None, None), (math.nan, 1.0), (-1.0, 1.0), (106.0, 1.0), (5.0, 0.0)]
)
def test_a_missing_or_absurd_measurement_keeps_the_last_forecast(
    power_kw: float | None, alpha: float | None
) -> None:
    last = measured(40.0, 50.0)
    found = forecast_impp(power_kw, alpha, RATING_KW, RATING_KW, last)
    assert found == last._replace(stale_cycles=1)


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 105.0), st.floats(0.05, 1.0), st.floats(0.0, 120.0, allow_nan=False)
        ),
        max_size=30,
    )
)
def test_whatever_is_measured_the_forecast_lies_between_zero_and_the_rating(
    history: list[tuple[float, float, float]],
) -> None:
    estimate = NOTHING_KNOWN
    for power_kw, alpha, limit_kw in history:
        estimate = forecast_impp(power_kw, alpha, limit_kw, RATING_KW, estimate)
        assert 0.0 <= estimate.power_kw <= RATING_KW
        assert estimate.spread_kw >= 0.0


def readings(
    limit_kw: float, errors: list[float], mpp_kw: float, last: ImppEstimate
) -> list[ImppEstimate]:
    """Estimates while a limit below the maximum holds and the meter reads with these errors."""
    found = []
    for error in errors:
        last = forecast_impp(limit_kw * (1.0 + error), 1.0, limit_kw, RATING_KW, last)
        found.append(last)
    assert mpp_kw > limit_kw
    return found


def test_a_noisy_meter_is_learned_from_what_it_reads_above_the_limit() -> None:
    noise = (0.05 * np.random.default_rng(2).standard_normal(400)).tolist()
    found = readings(40.0, noise, 80.0, measured(80.0))
    # Once it is known, no reading is taken for the maximum, and what is assumed of it only grows.
    assert all(estimate.stale_cycles > 0 for estimate in found[100:])
    assert found[-1].power_kw == RATING_KW
    assert found[-1].meter_error == pytest.approx(0.05 * 0.4, rel=0.4)  # E max(0, e) = 0.4 sigma


def test_a_cloud_below_the_limit_is_never_taken_for_the_meters_error() -> None:
    slowly = [-0.001 * cycle for cycle in range(60)]
    found = readings(40.0, slowly, 80.0, measured(80.0))
    assert found[-1].stale_cycles == 0
    assert found[-1].measured_kw == pytest.approx(40.0 * (1.0 - 0.059))


def test_a_meter_that_reads_low_is_known_by_what_the_inverter_gives_once_it_is_free() -> None:
    deceived = forecast_impp(37.6, 1.0, 40.0, RATING_KW, measured(80.0))
    assert deceived.measured_kw == 37.6, "6 % below its limit it seems to be in the shade"
    free = forecast_impp(75.2, 1.0, RATING_KW, RATING_KW, deceived)
    assert free.reads_low == pytest.approx(LOW_READING_SAFETY * 0.06)
    again = forecast_impp(37.6, 1.0, 40.0, RATING_KW, free)
    assert again.power_kw >= 75.2, "the same reading deceives it no more"
