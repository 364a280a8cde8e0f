"""Which inverters share a supervisor: clusters whose members fluctuate least alike.

The paper selects clusters "such that the correlation between inverters within a cluster is at a
minimum, so the probability of available headroom within a cluster is maximized" and gives no
method. Here steepest descent from several random starts minimises the sum over all pairs inside the
clusters: it swaps members between clusters for as long as a swap helps.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Clusters = tuple[tuple[int, ...], ...]

# Gains below this are rounding: without it two equal partitions could be swapped for ever.
_LEAST_GAIN = 1e-12

_STARTS = 20
"""Random starts of a search, of which the best result is kept."""


def search_clusters(correlation: NDArray[np.float64], sizes: Sequence[int]) -> Clusters:
    """Partition the inverters so that the correlation inside the clusters is least.

    Parameters
    ----------
    correlation : numpy.ndarray, shape (N, N)
        Symmetric correlation of the inverters (paper, eq. 5). The diagonal is not used.
    sizes : sequence of int
        How many inverters each cluster takes; the sum must be N.

    Returns
    -------
    tuple of tuple of int
        The best of all starts: the members of each cluster, ascending, in the order of the sizes
        asked for. Clusters of the same size are in the order of their first members.
    """
    cost = np.array(correlation, dtype=np.float64)
    np.fill_diagonal(cost, 0.0)
    rng = np.random.default_rng(0)
    start = np.repeat(np.arange(len(sizes)), sizes)
    best, best_cost = start, np.inf
    for _ in range(_STARTS):
        label = _descend(cost, rng.permutation(start), len(sizes))
        label_cost = float(cost[label[:, None] == label[None, :]].sum())
        if label_cost < best_cost - _LEAST_GAIN:
            best, best_cost = label, label_cost
    return _ordered(best, sizes)


def random_clusters(sizes: Sequence[int], seed: int) -> Clusters:
    """Partition the inverters at random, for comparison. All partitions are equally likely."""
    label = np.repeat(np.arange(len(sizes)), sizes)
    return _ordered(np.random.default_rng(seed).permutation(label), sizes)


def geographic_clusters(
    x_m: NDArray[np.float64], y_m: NDArray[np.float64], sizes: Sequence[int]
) -> Clusters:
    """Partition the inverters into compact neighbourhoods, for comparison with `search_clusters`.

    Minimises the sum of the squared distances between all pairs inside the clusters.

    Parameters
    ----------
    x_m, y_m : numpy.ndarray, shape (N,)
        Position of each inverter, east and north of any point [m].
    sizes : sequence of int
        How many inverters each cluster takes; the sum must be N.
    """
    position = np.column_stack([x_m, y_m])
    difference = position[:, None, :] - position[None, :, :]
    squared = np.sum(difference**2, axis=2)
    # In units of the largest distance, so that the least gain means the same as for correlations.
    largest = float(squared.max(initial=0.0))
    return search_clusters(squared / largest if largest > 0.0 else squared, sizes)


def _descend(cost: NDArray[np.float64], label: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Make the best swap of two members of different clusters until none lowers the cost."""
    label = label.copy()
    index = np.arange(len(label))
    change, new = np.zeros_like(cost), index
    while True:
        # joined[i, c]: cost of i with all members of cluster c
        joined = cost @ np.eye(count)[label]
        move = joined - joined[index, label][:, None]
        # Each of the two leaves its cluster for the other's, where its partner no longer is.
        part = move[:, label[new]] + move[new][:, label].T - 2.0 * cost[:, new]
        part[label[:, None] == label[new]] = 0.0
        change[:, new], change[new] = part, part.T
        first, second = np.unravel_index(np.argmin(change), change.shape)
        if change[first, second] >= -_LEAST_GAIN:
            return label
        label[first], label[second] = label[second], label[first]
        # A swap changes the gains only of swaps that involve one of its two clusters.
        new = np.flatnonzero((label == label[first]) | (label == label[second]))


def _ordered(label: NDArray[np.intp], sizes: Sequence[int]) -> Clusters:
    members = [tuple(np.flatnonzero(label == c).tolist()) for c in range(len(sizes))]
    by_size = {size: sorted(m for m in members if len(m) == size) for size in set(sizes)}
    return tuple(by_size[size].pop(0) for size in sizes)
