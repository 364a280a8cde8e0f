"""Step 1, equation 1: the estimated maximum power of an inverter."""

import math

import pytest

from agents.control.impp import Estimate, estimate_impp

RATING_KW = 100.0
LAST = Estimate(power_kw=72.0, stale_cycles=2)


def estimated(
    power_kw: float, alpha: float, last: Estimate = LAST, available_kw: float = math.nan
) -> tuple[float, int]:
    """IMPP and its age after one more measurement."""
    found = estimate_impp(power_kw, alpha, available_kw, RATING_KW, last)
    return found.power_kw, found.stale_cycles


@pytest.mark.parametrize(
    ("power_kw", "alpha", "impp_kw"),
    [
        (30.0, 0.6, 50.0),  # delivered at 60 % of the maximum: 30 / 0.6
        (43.7, 1.0, 43.7),  # uncurtailed it shows its maximum itself
        (0.0, 1.0, 0.0),  # in the dark
        (60.0, 0.5, RATING_KW),  # 120 kW would be more than it can convert
        (1e-3, 5e-324, RATING_KW),  # the least alpha above zero does not overflow
        (RATING_KW, 1.0, RATING_KW),
    ],
)
def test_equation_1_divides_the_measured_power_by_the_alpha_applied_with_it(
    power_kw: float, alpha: float, impp_kw: float
) -> None:
    assert estimated(power_kw, alpha) == (impp_kw, 0)


@pytest.mark.parametrize(
    ("power_kw", "alpha"),
    [
        (math.nan, 1.0),
        (-0.001, 1.0),
        (105.001, 1.0),
        (50.0, math.nan),
        (50.0, 0.0),
        (50.0, 1.001),
    ],
)
def test_a_missing_or_absurd_measurement_keeps_the_last_estimate_and_ages_it(
    power_kw: float, alpha: float
) -> None:
    assert estimated(power_kw, alpha) == (72.0, 3)


@pytest.mark.parametrize(
    ("alpha", "available_kw", "impp_kw"),
    [
        (0.6, 80.0, 80.0),  # behind a power limit P / alpha need not be its maximum
        (0.6, 102.0, RATING_KW),
        *((0.6, absurd_kw, 50.0) for absurd_kw in (math.nan, -1.0, 106.0, math.inf)),
        (1.0, 33.0, 30.0),  # uncurtailed it shows its maximum whatever it states
    ],
)
def test_a_curtailed_inverter_is_believed_what_it_states(
    alpha: float, available_kw: float, impp_kw: float
) -> None:
    assert estimated(30.0, alpha, available_kw=available_kw) == (impp_kw, 0)
