"""RMSE and MAE, worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.metrics.tracking import tracking_error

POWERS = st.lists(st.floats(0.0, 1e4), min_size=1, max_size=30)


def test_deviations_above_and_below_count_alike() -> None:
    desired_kw = np.array([100.0, 100.0, 100.0, 100.0])
    delivered_kw = np.array([97.0, 100.0, 104.0, 100.0])
    found = tracking_error(desired_kw, delivered_kw)
    assert found.rmse_kw == pytest.approx(2.5)  # sqrt((9 + 0 + 16 + 0) / 4)
    assert found.mae_kw == pytest.approx(1.75)  # (3 + 0 + 4 + 0) / 4


def test_what_was_desired_and_delivered_has_no_error() -> None:
    found = tracking_error(np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    assert (found.rmse_kw, found.mae_kw) == (0.0, 0.0)


@given(POWERS)
def test_the_root_mean_square_is_never_below_the_mean(delivered: list[float]) -> None:
    found = tracking_error(np.full(len(delivered), 50.0), np.array(delivered))
    assert found.mae_kw <= found.rmse_kw * (1.0 + 1e-12)
    assert found.rmse_kw <= found.mae_kw * np.sqrt(len(delivered)) * (1.0 + 1e-12)
