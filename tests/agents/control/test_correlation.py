"""The hourly correlation matrices of the paper's equation 5."""

import numpy as np
import pytest

from agents.control.correlation import (
    group_correlation,
    hourly_correlation,
    hourly_deviations,
)


def random_walks(rows: int, columns: int, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, columns)).cumsum(axis=0) + 200.0


def test_each_hour_equals_numpy_on_the_rows_of_that_hour_of_all_days() -> None:
    power = random_walks(4000, 17)
    hour = np.tile(np.repeat([10, 11], 1000), 2)
    correlation, deviations = hourly_correlation(power, hour), hourly_deviations(power, hour)
    assert list(correlation) == [10, 11]
    for h in correlation:
        rows = power[hour == h].T
        np.testing.assert_allclose(correlation[h], np.corrcoef(rows), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(
            deviations[h].T, rows - rows.mean(axis=1, keepdims=True), atol=1e-9
        )
        assert np.array_equal(np.diag(correlation[h]), np.ones(17))


@pytest.mark.parametrize("level", [0.0, 0.1, 470.588235294])
def test_a_series_that_does_not_vary_counts_as_fully_correlated(level: float) -> None:
    power = random_walks(3600, 3)
    power[:, 1] = level
    found = hourly_correlation(power, np.full(3600, 6))[6]
    assert np.array_equal(found[1], [1.0, 1.0, 1.0])
    assert np.array_equal(found[:, 1], [1.0, 1.0, 1.0])
    assert found[0, 2] == pytest.approx(np.corrcoef(power[:, 0], power[:, 2])[0, 1], abs=1e-12)


def test_group_correlation_is_that_of_the_summed_series() -> None:
    power = random_walks(1800, 7)
    groups = [(0, 3, 5), (1,), (2, 4, 6)]
    deviations = hourly_deviations(power, np.full(1800, 13))[13]
    sums = np.column_stack([power[:, list(group)].sum(axis=1) for group in groups])
    np.testing.assert_allclose(
        group_correlation(deviations, groups), np.corrcoef(sums.T), rtol=0.0, atol=1e-12
    )
