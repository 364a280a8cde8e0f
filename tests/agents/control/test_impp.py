"""From measured power to the maximum (equation 1), and from a setpoint to alpha (equation 6)."""

import math

import pytest

from agents.control.impp import Estimate, curtailment_level, estimate_impp

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
        (-0.02, 0.5, 0.0),  # tripped, it draws standby power
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
        (-5.001, 1.0),
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


@pytest.mark.parametrize(
    ("setpoint_kw", "impp_kw", "alpha"),
    [
        (30.0, 50.0, 0.6),  # 30 / 50
        (50.0, 50.0, 1.0),
        (4.0, 50.0, 0.08),  # 4 / 50, above alpha_min
        (2.499, 50.0, 0.05),  # 2.5 kW are the least, so that the IMPP can be measured
        (0.0, 50.0, 0.05),
        (49.9999995, 50.0, pytest.approx(1.0 - 1e-8, abs=1e-12)),  # more than rounding
        (0.0, 0.0, 1.0),  # without power it is let free
        (10.0, 0.0, 1.0),
        (10.0, 5e-324, 1.0),  # the faintest light does not overflow
    ],
)
def test_equation_6_is_setpoint_over_impp(setpoint_kw: float, impp_kw: float, alpha: float) -> None:
    assert curtailment_level(setpoint_kw, impp_kw, alpha_min=0.05) == alpha


@pytest.mark.parametrize("share", [1.0 - 1e-15, 1.0 - 0.99e-9, 1.0 + 1e-15])
@pytest.mark.parametrize("impp_kw", [1e-9, 470.588])
def test_the_last_bits_of_a_setpoint_do_not_decide_whether_an_inverter_is_free(
    share: float, impp_kw: float
) -> None:
    assert curtailment_level(share * impp_kw, impp_kw, alpha_min=0.05) == 1.0
