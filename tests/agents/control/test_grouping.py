"""Grouping control by hand: three inverters, the first of them the reference group."""

import numpy as np
import pytest

from agents.control.grouping import grouping_levels, grouping_limits_kw

RATING_KW = np.array([100.0, 200.0, 100.0])
REFERENCE = np.array([True, False, False])


def limits_kw(reference_kw: float, desired_kw: float) -> list[float]:
    found = grouping_limits_kw(
        np.array([reference_kw]), np.array([desired_kw]), RATING_KW, REFERENCE
    )
    return list(found[0])


def test_the_control_group_shares_what_the_reference_group_leaves_by_capacity() -> None:
    # Potential 400 / 100 x 80 = 320 kW. Of the 200 kW wanted 80 are there; 120 remain, 2 : 1.
    assert limits_kw(80.0, 200.0) == [np.inf, pytest.approx(80.0), pytest.approx(40.0)]


def test_no_more_is_asked_than_the_potential() -> None:
    # Potential 160 kW: of 300 kW wanted only 160 - 40 = 120 are asked of the control group.
    assert limits_kw(40.0, 300.0) == [np.inf, pytest.approx(80.0), pytest.approx(40.0)]


def test_the_plant_cannot_go_below_its_reference_group() -> None:
    assert limits_kw(80.0, 50.0) == [np.inf, 0.0, 0.0]


@pytest.mark.parametrize(
    ("reference_kw", "desired_kw", "level"),
    [
        (80.0, 200.0, 0.5),  # The others could give 3 x 80 = 240 kW; 120 kW are wanted of them.
        (40.0, 300.0, 1.0),
        (80.0, 50.0, 0.0),
        (0.0, 100.0, 1.0),
    ],
)
def test_the_control_group_has_one_level_for_all(
    reference_kw: float, desired_kw: float, level: float
) -> None:
    seen = np.array([reference_kw]), np.array([desired_kw])
    found = grouping_levels(*seen, RATING_KW, REFERENCE)
    assert list(found[0]) == [1.0, pytest.approx(level), pytest.approx(level)]


@pytest.mark.parametrize("reference", [np.zeros(3, dtype=bool), np.ones(3, dtype=bool)])
def test_a_group_of_none_or_all_is_refused(reference: np.ndarray) -> None:
    with pytest.raises(ValueError, match="reference group of 1 to 2"):
        grouping_limits_kw(np.ones(1), np.ones(1), RATING_KW, reference)
