"""The end of step 4, equation 6: from a setpoint to the curtailment level alpha."""

import math

import pytest

from agents.control.curtailment import curtailment_level
from agents.control.impp import NOTHING_KNOWN, estimate_impp


@pytest.mark.parametrize(
    ("setpoint_kw", "impp_kw", "alpha"),
    [
        (30.0, 50.0, 0.6),  # 30 / 50
        (50.0, 50.0, 1.0),
        (4.0, 50.0, 0.08),  # 4 / 50, above alpha_min
        (49.9999995, 50.0, pytest.approx(1.0 - 1e-8, abs=1e-12)),  # more than rounding
        (0.0, 0.0, 1.0),  # without power it is let free
        (10.0, 0.0, 1.0),
        (10.0, 5e-324, 1.0),  # the faintest light does not overflow
    ],
)
def test_equation_6_is_setpoint_over_impp(setpoint_kw: float, impp_kw: float, alpha: float) -> None:
    assert curtailment_level(setpoint_kw, impp_kw, alpha_min=0.05) == alpha


@pytest.mark.parametrize("setpoint_kw", [0.0, 1.0, 2.499])
def test_alpha_stays_at_its_minimum_so_that_the_impp_can_be_measured(setpoint_kw: float) -> None:
    # 0.05 x 50 kW = 2.5 kW is the least that is commanded.
    alpha = curtailment_level(setpoint_kw, 50.0, alpha_min=0.05)
    assert alpha == 0.05
    assert estimate_impp(alpha * 50.0, alpha, math.nan, 100.0, NOTHING_KNOWN).power_kw == 50.0


@pytest.mark.parametrize("share", [1.0 - 1e-15, 1.0 - 0.99e-9, 1.0 + 1e-15])
@pytest.mark.parametrize("impp_kw", [1e-9, 470.588])
def test_the_last_bits_of_a_setpoint_do_not_decide_whether_an_inverter_is_free(
    share: float, impp_kw: float
) -> None:
    assert curtailment_level(share * impp_kw, impp_kw, alpha_min=0.05) == 1.0
