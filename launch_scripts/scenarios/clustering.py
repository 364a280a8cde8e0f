"""From the past of a plant to its control tree and its virtual neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agents.control.clusters import geographic_clusters, random_clusters, search_clusters
from agents.control.correlation import HourlyMatrices, group_correlation
from agents.plan import Neighbourhood, NodeNeighbourhoods
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.scenario import ControlTable
from sim_plant.positions import east_north_m
from sim_plant.sites import Sites

_TIER_LETTERS: Final = "czar"
"""Clusters are c1, c2, ...; zones of clusters z1, ...; then areas and regions."""


def control_tree(
    control: ControlTable, sites: Sites, covariance: HourlyMatrices, hours: Sequence[int]
) -> ControlTree:
    """Cluster inverters, then clusters, and so on, by their mean correlation in these hours."""
    groups: list[tuple[int, ...]] = [(index,) for index in range(len(sites.names))]
    paths = list(sites.names)
    for tier in range(_tiers_of_clusters(control)):
        sizes = _sizes(control, tier, len(groups))
        clusters = _choose(control, sizes, groups, sites, covariance, hours)
        paths = _with_prefix(paths, groups, clusters, tier)
        groups = [
            tuple(leaf for place in cluster for leaf in groups[place]) for cluster in clusters
        ]
    order = [leaf for group in groups for leaf in group]
    return ControlTree(tuple((paths[leaf], float(sites.rating_kw[leaf])) for leaf in order))


def neighbourhoods(
    tree: ControlTree, covariance: HourlyMatrices, began_ns: dict[int, int]
) -> tuple[NodeNeighbourhoods, ...]:
    """Return the correlation between each parent's children, from the beginning of each hour on."""
    return tuple(
        NodeNeighbourhoods(
            parent,
            tuple(
                Neighbourhood(time_ns, _child_correlation(tree, parent, covariance[hour]))
                for hour, time_ns in sorted(began_ns.items())
            ),
        )
        for parent in tree.parents
    )


def in_order(covariance: HourlyMatrices, order: Sequence[int]) -> HourlyMatrices:
    """Return the matrices with rows and columns in another order."""
    return {hour: matrix[order][:, order] for hour, matrix in covariance.items()}


def _tiers_of_clusters(control: ControlTable) -> int:
    """Refuse a control table that says twice what the clusters are, or not at all."""
    given = [value for value in (control.cluster_sizes, control.cluster_count) if value is not None]
    if len(given) != 1:
        raise InputError(
            "control.cluster_sizes, cluster_count: expected one of the two, got "
            f"{'both' if given else 'neither'}"
        )
    return len(given[0])


def _sizes(control: ControlTable, tier: int, members: int) -> tuple[int, ...]:
    """Sizes of the clusters of a tier, largest first where only their count is given."""
    if control.cluster_sizes is not None:
        sizes = control.cluster_sizes[tier]
        if sum(sizes) != members:
            raise InputError(
                f"control.cluster_sizes[{tier}]: expected sizes that add up to {members}, got "
                f"{sum(sizes)}"
            )
        return sizes
    count = (control.cluster_count or ())[tier]
    if count > members:
        raise InputError(
            f"control.cluster_count[{tier}]: expected 1 to {members} clusters, got {count}"
        )
    smaller, larger = divmod(members, count)
    return (smaller + 1,) * larger + (smaller,) * (count - larger)


def _choose(
    control: ControlTable,
    sizes: Sequence[int],
    groups: list[tuple[int, ...]],
    sites: Sites,
    covariance: HourlyMatrices,
    hours: Sequence[int],
) -> Sequence[Sequence[int]]:
    match control.clusters:
        case "correlation":
            return search_clusters(_mean_correlation(groups, covariance, hours), sizes).clusters
        case "most-alike":
            return search_clusters(-_mean_correlation(groups, covariance, hours), sizes).clusters
        case "geographic":
            return geographic_clusters(*_positions_m(groups, sites), sizes)
        case "random":
            return random_clusters(sizes, control.clusters_seed)
        case "listed":
            return [range(low, high) for low, high in pairwise(np.cumsum([0, *sizes]).tolist())]


def _mean_correlation(
    groups: list[tuple[int, ...]], covariance: HourlyMatrices, hours: Sequence[int]
) -> NDArray[np.float64]:
    """Return the correlation between groups, the mean of all hours that decide."""
    hourly = [group_correlation(covariance[hour], groups) for hour in hours]
    return np.asarray(np.mean(hourly, axis=0))


def _positions_m(
    groups: list[tuple[int, ...]], sites: Sites
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middle of each group, east and north [m]."""
    east_m, north_m = east_north_m(sites.lat_deg, sites.lon_deg)
    return (
        np.array([east_m[list(group)].mean() for group in groups]),
        np.array([north_m[list(group)].mean() for group in groups]),
    )


def _with_prefix(
    paths: list[str], groups: list[tuple[int, ...]], clusters: Sequence[Sequence[int]], tier: int
) -> list[str]:
    letter = _TIER_LETTERS[tier] if tier < len(_TIER_LETTERS) else f"t{tier}_"
    prefixed = list(paths)
    for number, cluster in enumerate(clusters, start=1):
        for place in cluster:
            for leaf in groups[place]:
                prefixed[leaf] = f"{letter}{number}/{paths[leaf]}"
    return prefixed


def _child_correlation(
    tree: ControlTree, parent: str, covariance: NDArray[np.float64]
) -> tuple[tuple[float, ...], ...]:
    groups = [tree.leaves_below(child) for child in tree.children(parent)]
    return tuple(tuple(row) for row in group_correlation(covariance, groups).tolist())
