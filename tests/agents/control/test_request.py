"""A dispatch that is no number, or is outside what a plant can deliver."""

import math

import pytest

from agents.control.request import usable_dispatch_kw


@pytest.mark.parametrize(
    ("dispatch_kw", "usable_kw"),
    [(40.0, 40.0), (-5.0, 0.0), (150.0, 100.0), (math.nan, 30.0), (math.inf, 30.0)],
)
def test_a_dispatch_lies_between_0_and_the_rating_or_the_last_one_holds(
    dispatch_kw: float, usable_kw: float
) -> None:
    assert usable_dispatch_kw(dispatch_kw, 30.0, 100.0) == usable_kw
