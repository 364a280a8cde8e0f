"""Uniform cap and grouping with both actuators, power by power."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from recorded_runs import plan_of

from agents.settings import Actuator
from sim_plant.profile import Profile
from studies.arrays.schemes import reference_groups, run_scheme

PLAN = plan_of({"c1/a": 100.0, "c1/b": 100.0, "c2/c": 120.0, "c2/d": 60.0}, cycles=2)
MPP_KW = np.array([[80.0, 40.0, 120.0, 60.0], [60.0, 50.0, 100.0, 0.0]])


def powers_kw(
    scheme: str, actuator: Actuator, dispatch_kw: float, meter_error: float = 0.0
) -> NDArray[np.float64]:
    error = np.full_like(MPP_KW, meter_error)
    profile = Profile(MPP_KW, np.full(2, dispatch_kw), meter_error=error)
    first_alone = np.array([True, False, False, False])
    (series,) = run_scheme(scheme, PLAN, profile, actuator, [first_alone])
    return series.power_kw


@pytest.mark.parametrize(
    ("scheme", "actuator", "dispatch_kw", "expected_kw"),
    [
        # Of 190 kW the shares are 50, 50, 60 and 30 kW.
        ("uniform-cap", "limit", 190.0, [[50.0, 40.0, 60.0, 30.0], [50.0, 50.0, 60.0, 0.0]]),
        # By the maximum of the last cycle the levels are 50/80, 1, 60/120 and 30/60 in both.
        ("uniform-cap", "fraction", 190.0, [[50.0, 40.0, 60.0, 30.0], [37.5, 50.0, 50.0, 0.0]]),
        # a gave 80 kW of its 100: the others promise 224 kW, of which 112 are wanted, 0.4 of each
        # rating. Behind fractions they have one level, 0.5.
        ("grouping", "limit", 192.0, [[80.0, 40.0, 48.0, 24.0], [60.0, 40.0, 48.0, 0.0]]),
        ("grouping", "fraction", 192.0, [[80.0, 20.0, 60.0, 30.0], [60.0, 25.0, 50.0, 0.0]]),
    ],
)
def test_schemes_by_hand(
    scheme: str, actuator: Actuator, dispatch_kw: float, expected_kw: list[list[float]]
) -> None:
    assert powers_kw(scheme, actuator, dispatch_kw) == pytest.approx(np.array(expected_kw))


def test_meters_that_read_high_curtail_too_much_and_the_floor_holds() -> None:
    high = powers_kw("uniform-cap", "fraction", 190.0, meter_error=0.25)
    assert high[0] == pytest.approx([50.0, 40.0, 60.0, 30.0] / np.array([1.25, 1.0, 1.0, 1.0]))
    assert powers_kw("uniform-cap", "fraction", 0.0) == pytest.approx(
        PLAN.control.alpha_min * MPP_KW
    )


def test_grouping_tries_the_sizes_that_the_plant_is_large_enough_for() -> None:
    sizes = [int(mask.sum()) for mask in reference_groups(4)]
    assert sizes == [1] * 4 + [2] * 12 + [3] * 12
