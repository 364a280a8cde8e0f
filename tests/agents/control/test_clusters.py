"""Clusters whose members fluctuate least alike."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.clusters import (
    geographic_clusters,
    random_clusters,
    search_clusters,
)


def random_correlation(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    common = rng.standard_normal((300, 3)) @ rng.standard_normal((3, count))
    return np.asarray(np.corrcoef((common + rng.standard_normal((300, count))).T))


def cost(correlation: np.ndarray, clusters: Sequence[Sequence[int]]) -> float:
    return float(sum(correlation[i, j] for c in clusters for i, j in combinations(c, 2)))


def least_cost_by_enumeration(
    correlation: np.ndarray, everyone: set[int], sizes: Sequence[int]
) -> float:
    if not sizes:
        return 0.0
    return min(
        cost(correlation, [first])
        + least_cost_by_enumeration(correlation, everyone - set(first), sizes[1:])
        for first in combinations(sorted(everyone), sizes[0])
    )


@pytest.mark.parametrize(("seed", "sizes"), [(0, (3, 7)), (1, (5, 5)), (2, (4, 3, 2))])
def test_the_best_of_all_partitions_is_found(seed: int, sizes: tuple[int, ...]) -> None:
    count = sum(sizes)
    correlation = random_correlation(count, seed)
    found = cost(correlation, search_clusters(correlation, sizes))
    least = least_cost_by_enumeration(correlation, set(range(count)), sizes)
    assert found == pytest.approx(least, abs=1e-12)


@given(
    sizes=st.lists(st.integers(1, 5), min_size=1, max_size=5),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40)
def test_every_inverter_is_in_one_cluster_of_the_size_asked_for(
    sizes: list[int], seed: int
) -> None:
    correlation = np.atleast_2d(random_correlation(sum(sizes), seed))
    for clusters in (search_clusters(correlation, sizes), random_clusters(sizes, seed)):
        assert [len(c) for c in clusters] == sizes
        assert sorted(i for c in clusters for i in c) == list(range(sum(sizes)))
        assert all(list(c) == sorted(c) for c in clusters)
        for one, other in combinations(clusters, 2):
            assert len(one) != len(other) or one[0] < other[0]


def test_geographic_clusters_are_the_three_villages() -> None:
    x_m = np.array([0.0, 5000.0, 10.0, 5010.0, 20.0, 0.0, 5000.0, 10.0])
    y_m = np.array([0.0, 0.0, 10.0, 10.0, 0.0, 4000.0, 20.0, 4010.0])
    assert geographic_clusters(x_m, y_m, (3, 3, 2)) == ((0, 2, 4), (1, 3, 6), (5, 7))
