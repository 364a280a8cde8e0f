"""What a grid asks of a plant, against numbers worked out by hand."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest

from agents.control.grid import GridLaw, desired_kw, gross_kw, net_kw, ramped_kw, response_kw
from agents.settings import Droop, GridSettings

RATING_KW = 8000.0


def law_of(cycle_s: float = 1.0, **settings: Any) -> GridLaw:
    return GridSettings(**settings).law(RATING_KW, cycle_s)


@pytest.mark.parametrize(
    ("frequency_hz", "expected_kw"),
    [
        (60.0, 0.0),
        (59.964, 0.0),  # The deadband of 36 mHz.
        (60.036, 0.0),
        # 0.3 Hz of 60 are 0.005; less 0.0006, times 20, times 8000 kW.
        (59.7, 704.0),
        (60.3, -704.0),
        (59.4, 800.0),  # 1504 kW, but a reserve of 10 %.
        (60.6, -1504.0),
        (nan, 0.0),
    ],
)
def test_the_droop_responds_beyond_its_deadband_upwards_out_of_the_reserve(
    frequency_hz: float, expected_kw: float
) -> None:
    law = law_of(droop=Droop(reserve_percent=10.0))
    assert response_kw(frequency_hz, law) == pytest.approx(expected_kw, abs=1e-6)


def test_the_reference_follows_the_dispatch_within_the_ramp_limits_of_a_cycle() -> None:
    law = law_of(cycle_s=2.0, ramp_up_kw_per_min=600.0, ramp_down_kw_per_min=1200.0)
    # 2 s of 600 kW/min are 20 kW, of 1200 kW/min 40 kW.
    assert ramped_kw(4000.0, 5000.0, law) == 4020.0
    assert ramped_kw(4000.0, 3000.0, law) == 3960.0
    assert ramped_kw(4000.0, 4010.0, law) == 4010.0
    assert ramped_kw(nan, 5000.0, law) == 5000.0
    assert ramped_kw(4000.0, 0.0, law_of(ramp_up_kw_per_min=600.0)) == 0.0


def test_limits_come_in_their_order_reserve_response_then_lowest_and_highest_power() -> None:
    law = law_of(droop=Droop(reserve_percent=10.0), pmin=0.05, pmax=0.9)
    # Of 5000 kW that are possible 800 are kept; the response comes on top of the rest.
    assert desired_kw(6000.0, 0.0, 5000.0, law) == 4200.0
    assert desired_kw(6000.0, 800.0, 5000.0, law) == 5000.0
    assert desired_kw(4000.0, 800.0, 5000.0, law) == 4800.0
    # The highest power is 7200 kW, so that with the reserve 6400 are left.
    assert desired_kw(8000.0, 0.0, inf, law) == 6400.0
    assert desired_kw(8000.0, 800.0, inf, law) == 7200.0
    assert desired_kw(1000.0, -1504.0, 5000.0, law) == 400.0
    assert desired_kw(4000.0, 0.0, 500.0, law) == 400.0


def test_losses_are_a_constant_share_and_one_of_the_square_of_the_power() -> None:
    law = law_of(loss_constant_percent=0.5, loss_quadratic_percent=2.0)
    assert net_kw(RATING_KW, law) == pytest.approx(8000.0 - 40.0 - 160.0)
    assert net_kw(4000.0, law) == pytest.approx(4000.0 - 40.0 - 40.0)
    assert net_kw(0.0, law) == -40.0
    assert gross_kw(net_kw(4321.0, law), law) == pytest.approx(4321.0)
    assert gross_kw(10.0, law_of(loss_constant_percent=0.5)) == 50.0


def test_deadband_and_droop_differ_above_and_below_the_nominal_frequency() -> None:
    droop = Droop(fdbd1=-0.001, fdbd2=0.002, ddn=25.0, dup=10.0, reserve_percent=100.0)
    law = law_of(nominal_hz=50.0, droop=droop)
    # 0.2 Hz of 50 are 0.004.
    assert response_kw(49.8, law) == pytest.approx(10.0 * 0.002 * RATING_KW)
    assert response_kw(50.2, law) == pytest.approx(-25.0 * 0.003 * RATING_KW)
