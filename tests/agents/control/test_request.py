"""Step 2, equations 3 and 4: what is asked of each child, what it has left or lacks."""

import pytest

from agents.control.request import residual_kw, split_by_capacity


def test_equation_3_asks_the_same_of_equal_inverters() -> None:
    # 120 kW / 3 inverters.
    assert split_by_capacity(120.0, [50.0, 50.0, 50.0]) == pytest.approx((40.0, 40.0, 40.0))


def test_unequal_ratings_are_asked_in_proportion() -> None:
    # 90 kW over 30 + 60 + 90 = 180 kW: half of each rating.
    assert split_by_capacity(90.0, [30.0, 60.0, 90.0]) == pytest.approx((15.0, 30.0, 45.0))


def test_a_request_may_exceed_the_ratings() -> None:
    # 300 kW over 50 + 100 kW: twice each rating.
    assert split_by_capacity(300.0, [50.0, 100.0]) == pytest.approx((100.0, 200.0))


def test_nothing_asked_is_nothing_for_each() -> None:
    assert split_by_capacity(0.0, [50.0, 100.0]) == (0.0, 0.0)


def test_an_only_child_gets_the_whole() -> None:
    assert split_by_capacity(33.3, [50.0]) == (33.3,)


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
