"""Step 1, equations 1 and 2: the estimated maximum power of an inverter, and of a parent."""

import math

import pytest

from agents.agent import Turn
from agents.control.impp import ImppEstimate, estimate_impp
from agents.family import Family, Report
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP

RATING_KW = 100.0
LAST = ImppEstimate(power_kw=72.0, stale_cycles=2)


def test_equation_1_divides_the_measured_power_by_the_alpha_applied_with_it() -> None:
    # 30 kW delivered at 60 % of the maximum: the maximum is 30 / 0.6 = 50 kW.
    assert estimate_impp(30.0, 0.6, RATING_KW, LAST) == ImppEstimate(50.0, 0)


def test_an_uncurtailed_inverter_shows_its_maximum_itself() -> None:
    assert estimate_impp(43.7, 1.0, RATING_KW, LAST) == ImppEstimate(43.7, 0)


def test_an_inverter_in_the_dark_has_no_power_to_give() -> None:
    assert estimate_impp(0.0, 1.0, RATING_KW, LAST) == ImppEstimate(0.0, 0)


def test_the_estimate_is_capped_at_the_rating() -> None:
    # 60 / 0.5 = 120 kW: more than the inverter can convert.
    assert estimate_impp(60.0, 0.5, RATING_KW, LAST) == ImppEstimate(100.0, 0)


def test_the_least_alpha_above_zero_does_not_overflow() -> None:
    assert estimate_impp(1e-3, 5e-324, RATING_KW, LAST) == ImppEstimate(100.0, 0)


@pytest.mark.parametrize("power_kw", [0.0, RATING_KW])
def test_the_limits_of_a_plausible_power_are_plausible(power_kw: float) -> None:
    assert estimate_impp(power_kw, 1.0, RATING_KW, LAST) == ImppEstimate(power_kw, 0)


@pytest.mark.parametrize(
    ("power_kw", "alpha"),
    [
        (None, 1.0),
        (None, None),
        (math.nan, 1.0),
        (math.inf, 1.0),
        (-math.inf, 1.0),
        (-0.001, 1.0),
        (105.001, 1.0),
        (50.0, None),
        (50.0, math.nan),
        (50.0, 0.0),
        (0.0, 0.0),
        (50.0, -0.5),
        (50.0, 1.001),
        (50.0, math.inf),
    ],
)
def test_a_missing_or_absurd_measurement_keeps_the_last_estimate_and_ages_it(
    power_kw: float | None, alpha: float | None
) -> None:
    assert estimate_impp(power_kw, alpha, RATING_KW, LAST) == ImppEstimate(72.0, 3)


def test_a_good_measurement_after_bad_ones_is_fresh_again() -> None:
    estimate = estimate_impp(50.0, 0.5, RATING_KW, ImppEstimate(0.0, 0))
    for age in (1, 2, 3):
        estimate = estimate_impp(math.nan, 0.5, RATING_KW, estimate)
        assert estimate == ImppEstimate(100.0, age)
    assert estimate_impp(10.0, 0.5, RATING_KW, estimate) == ImppEstimate(20.0, 0)


def test_equation_2_adds_up_the_children() -> None:
    family = Family("c1", ("c1/a", "c1/b", "c1/c"), (100.0, 100.0, 100.0), (), hold_cycles=3)
    reports = (
        Report(80.0, 30.0, 0, 0, 0),
        Report(20.5, -29.5, 4, 0, 0),
        Report(0.0, -50.0, 1, 0, 0),
    )
    turn = Turn("report", 7, 0, (7, 0, "c1", ()), {})
    outputs = dict(family.report_up(turn, reports))
    # 80 + 20.5 + 0 kW; the oldest measurement among the children is 4 cycles old.
    assert outputs[IMPP.of("c1")] == Impp(7, 0, "c1", (), power_kw=100.5, stale_cycles=4)
