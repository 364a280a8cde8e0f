"""Step 2, equations 3 and 4: what is asked of a node, what it has left or lacks."""

import math

import pytest

from agents.control.request import request_kw, residual_kw, usable_dispatch_kw


def test_unequal_ratings_are_asked_in_proportion() -> None:
    # 90 kW over 30 + 60 + 90 = 180 kW: half of each rating.
    found = [request_kw(90.0, rating_kw, 180.0) for rating_kw in (30.0, 60.0, 90.0)]
    assert found == pytest.approx([15.0, 30.0, 45.0])


@pytest.mark.parametrize(
    ("dispatch_kw", "usable_kw"),
    [(40.0, 40.0), (-5.0, 0.0), (150.0, 100.0), (math.nan, 30.0), (math.inf, 30.0)],
)
def test_a_dispatch_lies_between_0_and_the_rating_or_the_last_one_holds(
    dispatch_kw: float, usable_kw: float
) -> None:
    assert usable_dispatch_kw(dispatch_kw, 30.0, 100.0) == usable_kw


@pytest.mark.parametrize(
    ("impp_kw", "request_kw", "expected_kw"),
    [
        (70.0, 40.0, 30.0),  # headroom
        (40.0, 40.0, 0.0),  # just enough: no need for assistance
        (25.0, 40.0, -15.0),  # 15 kW short
        (0.0, 40.0, -40.0),  # dark: all of it is missing
    ],
)
def test_equation_4_is_impp_less_request(
    impp_kw: float, request_kw: float, expected_kw: float
) -> None:
    assert residual_kw(impp_kw, request_kw) == expected_kw
