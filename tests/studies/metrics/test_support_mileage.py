"""Mileage of the support power, worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.metrics.mileage import support_mileage


def test_mileage_adds_up_what_the_support_rises_and_falls() -> None:
    # 10 up, 0, 7 down, 2 up: 19 kW within five cycles of 30 s, 2.5 minutes
    found = support_mileage(np.array([0.0, 10.0, 10.0, 3.0, 5.0]), cycle_s=30.0)
    assert found.total_kw == pytest.approx(19.0)
    assert found.per_minute_kw == pytest.approx(19.0 / 2.5)
    assert found.per_hour_kw == pytest.approx(19.0 / 2.5 * 60.0)


def test_support_that_does_not_change_has_no_mileage() -> None:
    assert support_mileage(np.full(4, 80.0), 1.0).total_kw == 0.0


def test_a_single_cycle_has_no_mileage() -> None:
    found = support_mileage(np.array([80.0]), 1.0)
    assert (found.total_kw, found.per_hour_kw, found.per_minute_kw) == (0.0, 0.0, 0.0)


@given(st.lists(st.floats(0.0, 1e4), min_size=1, max_size=30), st.integers(1, 5))
def test_finer_cycles_of_the_same_support_have_the_same_mileage(
    support: list[float], parts: int
) -> None:
    coarse = support_mileage(np.array(support), 10.0)
    fine = support_mileage(np.repeat(support, parts), 10.0 / parts)
    assert fine.total_kw == pytest.approx(coarse.total_kw)
    assert fine.per_hour_kw == pytest.approx(coarse.per_hour_kw)
