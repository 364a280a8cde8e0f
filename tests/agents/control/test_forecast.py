"""The IMPP as a forecast: trend, what is assumed of a hidden maximum, and where it is held."""

import math
from collections.abc import Sequence
from operator import attrgetter

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agents.control.forecast import (
    ERROR_MEMORY_S,
    HELD_SPREADS,
    HIDDEN_GROWTH_PER_S,
    MOST_DAMPING,
    TREND_TIME_S,
    Reading,
    forecast_impp,
    held_kw,
)
from agents.control.impp import NOTHING_KNOWN, Estimate

RATING_KW = 100.0
CYCLES_S = (0.1, 1.0, 10.0)


def forecast(
    power_kw: float,
    limit_kw: float,
    last: Estimate,
    *,
    alpha: float = 1.0,
    available_kw: float = math.nan,
    cycle_s: float = 1.0,
) -> Estimate:
    return forecast_impp(Reading(power_kw, alpha, available_kw, limit_kw), RATING_KW, cycle_s, last)


def measured(*maxima_kw: float, cycle_s: float = 1.0) -> Estimate:
    """The forecast after these maxima were measured, one a cycle, on a free inverter."""
    estimate = NOTHING_KNOWN
    for maximum_kw in maxima_kw:
        estimate = forecast(maximum_kw, RATING_KW, estimate, cycle_s=cycle_s)
    return estimate


def readings(limit_kw: float, errors: Sequence[float], last: Estimate) -> list[Estimate]:
    """Estimates while a limit holds and the meter reads with these errors."""
    found = []
    for error in errors:
        last = forecast(limit_kw * (1.0 + error), limit_kw, last)
        found.append(last)
    return found


SIXTY = measured(60.0)


@pytest.mark.parametrize(
    ("found", "maximum_kw"),
    [
        (measured(40.0), 40.0),
        (forecast(30.0, RATING_KW, NOTHING_KNOWN, alpha=0.6), 50.0),
        (forecast(30.0, 40.0, forecast(40.0, 40.0, SIXTY)), 30.0),
        (forecast(40.0, 40.0, SIXTY, available_kw=55.0), 55.0),
        (forecast(30.0, 40.0, SIXTY, available_kw=55.0), 30.0),
    ],
    ids=[
        "uncurtailed",
        "through the fraction applied",
        "below its limit again",
        "stated behind a limit",
        "below its limit, whatever is stated",
    ],
)
def test_a_maximum_that_is_seen(found: Estimate, maximum_kw: float) -> None:
    assert (found.maximum_kw, found.stale_cycles) == (maximum_kw, 0)


def test_the_last_change_is_expected_to_go_on_damped() -> None:
    found = measured(40.0, 50.0)
    trend_kw_per_s = 10.0 / (1.0 + TREND_TIME_S)
    spread_kw = 10.0 / math.sqrt(1.0 + ERROR_MEMORY_S)
    assert found.trend_kw_per_s == pytest.approx(trend_kw_per_s)
    assert found.power_kw == pytest.approx(50.0 + MOST_DAMPING * trend_kw_per_s)
    assert found.spread_kw == pytest.approx(spread_kw)


def test_asked_for_all_it_has_it_is_held_near_its_forecast_and_asked_for_more_it_is_free() -> None:
    known = measured(40.0, 50.0)
    held = held_kw(known.power_kw, RATING_KW, known)
    room_kw = held - known.power_kw
    assert HELD_SPREADS * known.spread_kw < room_kw < HELD_SPREADS * known.spread_kw + 1.0
    assert held_kw(known.power_kw + 0.1, RATING_KW, known) == RATING_KW


@pytest.mark.parametrize(("power_kw", "gives_room"), [(10.0, True), (33.0, False)])
def test_a_shadow_on_an_inverter_whose_limit_hid_its_maximum_gives_more_room_but_noise_none(
    power_kw: float, gives_room: bool
) -> None:
    hidden = forecast(40.0, 40.0, SIXTY)
    shaded = forecast(power_kw, 40.0, hidden)
    assert (shaded.spread_kw > hidden.spread_kw) == gives_room


@pytest.mark.parametrize("cycle_s", CYCLES_S)
def test_no_limit_keeps_an_inverter_dark_that_saw_no_sun_for_an_hour(cycle_s: float) -> None:
    """At dawn and after a trip: asked for all it has, it is seen at full power in time."""
    dark = measured(*[0.0] * 400, cycle_s=cycle_s)
    cycles = 0
    while dark.maximum_kw < RATING_KW:
        limit_kw = held_kw(dark.power_kw, RATING_KW, dark)
        dark = forecast(limit_kw, limit_kw, dark, cycle_s=cycle_s)
        cycles += 1
    assert cycles * cycle_s < max(120.0, 40.0 * cycle_s)


@pytest.mark.parametrize(("limit_kw", "from_kw"), [(40.0, 60.0), (80.0, 80.0)])
def test_a_maximum_behind_a_limit_is_assumed_to_grow_from_what_is_sure(
    limit_kw: float, from_kw: float
) -> None:
    """From the last one seen, or from the limit that is held."""
    hidden = forecast(limit_kw, limit_kw, SIXTY)
    assert hidden.power_kw == pytest.approx(from_kw * (1.0 + HIDDEN_GROWTH_PER_S))
    longer = forecast(limit_kw, limit_kw, hidden)
    assert longer.power_kw == pytest.approx(from_kw * (1.0 + HIDDEN_GROWTH_PER_S) ** 2)
    assert longer.stale_cycles == 0


def test_a_missing_or_absurd_measurement_keeps_the_last_forecast_and_ends_the_trend() -> None:
    last = measured(40.0, 50.0)
    once = forecast(math.nan, RATING_KW, last)
    twice = forecast(106.0, RATING_KW, once)
    assert (once.power_kw, once.stale_cycles) == (last.power_kw, 1)
    assert (twice.power_kw, twice.stale_cycles) == (last.power_kw, 2)
    seen = forecast(70.0, RATING_KW, twice)
    assert (seen.power_kw, seen.stale_cycles) == (70.0, 0)


@given(
    st.lists(
        st.tuples(
            st.floats(-5.0, 105.0),
            st.floats(0.05, 1.0),
            st.one_of(st.just(math.nan), st.floats(0.0, 105.0)),
            st.floats(0.0, 120.0),
        ),
        max_size=30,
    ),
    st.sampled_from(CYCLES_S),
)
@example([(-1.0, 1.0, math.nan, 0.0)], 1.0)
def test_whatever_is_measured_the_forecast_lies_between_zero_and_the_rating(
    history: list[tuple[float, float, float, float]], cycle_s: float
) -> None:
    estimate = NOTHING_KNOWN
    for power_kw, alpha, available_kw, limit_kw in history:
        estimate = forecast(
            power_kw, limit_kw, estimate, alpha=alpha, available_kw=available_kw, cycle_s=cycle_s
        )
        assert 0.0 <= estimate.power_kw <= RATING_KW
        assert estimate.spread_kw >= 0.0


# Time ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cycle_s", CYCLES_S)
@pytest.mark.parametrize(
    ("maxima_kw", "power_kw", "limit_kw", "seconds", "field", "change", "tolerance"),
    [
        # 30 s at 1 % a second; what compound interest makes of longer steps is little.
        ((40.0,), 20.0, 20.0, 30.0, "power_kw", 1.01**30, 0.02),
        ((40.0, *[60.0] * 3), 60.0, RATING_KW, 2 * ERROR_MEMORY_S, "spread_kw", math.exp(-1), 0.3),
        ((80.0,), 40.8, 40.0, 900.0, "meter.reads", 1.02, 0.002),
    ],
    ids=["a hidden maximum grows", "a forecast error is forgotten", "a meter's bias is learned"],
)
def test_effects_of_time_do_not_depend_on_the_cycle(
    maxima_kw: tuple[float, ...],
    power_kw: float,
    limit_kw: float,
    seconds: float,
    field: str,
    change: float,
    tolerance: float,
    cycle_s: float,
) -> None:
    before = later = measured(*maxima_kw, cycle_s=cycle_s)
    for _ in range(round(seconds / cycle_s)):
        later = forecast(power_kw, limit_kw, later, cycle_s=cycle_s)
    assert attrgetter(field)(later) / attrgetter(field)(before) == pytest.approx(
        change, rel=tolerance
    )


# Limit or cloud? ----------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("bias", [-0.01, 0.0, 0.01])
def test_how_a_noisy_meter_reads_a_limit_is_learned_while_the_limit_holds(
    bias: float, noise: float
) -> None:
    errors = bias + noise * np.random.default_rng(2).standard_normal(600)
    found = readings(40.0, errors.tolist(), measured(80.0))
    # Once it is known, no reading is taken for the maximum, and what is assumed of it only grows.
    assert not any(estimate.is_seen for estimate in found[300:])
    assert found[-1].power_kw == RATING_KW
    assert found[-1].meter.reads == pytest.approx(1.0 + bias, abs=0.3 * noise)
    assert found[-1].meter.error == pytest.approx(0.8 * noise, rel=0.3)  # E |e| = 0.8 sigma


def test_an_inverter_shaded_to_just_below_its_limit_does_not_count_as_held_by_it() -> None:
    # Its meter has proved exact while the limit held.
    held = readings(40.0, [0.0] * 600, measured(60.0))[-1]
    shaded = readings(40.0, [-0.01] * 30, held)
    assert all(estimate.is_seen for estimate in shaded)
    assert shaded[-1].power_kw == pytest.approx(40.0 * 0.99, rel=1e-3)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("bias", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("cycle_s", CYCLES_S)
def test_noise_does_not_refute_an_inverter_that_states_more_than_its_limit(
    cycle_s: float, bias: float, share: float
) -> None:
    stated_kw, limit_kw = 80.0 * (1.0 + bias), share * 80.0
    known = forecast(80.0, RATING_KW, NOTHING_KNOWN, available_kw=stated_kw, cycle_s=cycle_s)
    learned = known.meter.stated_share
    for error in 0.02 * np.random.default_rng(3).standard_normal(600):
        read_kw = limit_kw * (1.0 + error)
        known = forecast(read_kw, limit_kw, known, available_kw=stated_kw, cycle_s=cycle_s)
        assert known.power_kw == pytest.approx(80.0, rel=0.03)
    assert known.meter.stated_share == learned, "held by its limit it shows nothing of it"


def test_just_below_the_limit_of_an_inverter_that_is_asked_for_all_it_has_is_its_maximum() -> None:
    # Held a little above its forecast, 1 % below that limit is where its maximum is expected.
    known = measured(40.0)
    assert forecast(39.9, held_kw(40.0, RATING_KW, known), known).is_seen
    # With far more than it is asked for, the same reading is the meter's error.
    assert not forecast(39.9, 40.3, measured(80.0)).is_seen
