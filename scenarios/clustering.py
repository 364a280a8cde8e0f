"""From the past of a plant to its control tree and its virtual neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agents.control.clusters import geographic_clusters, random_clusters, search_clusters
from agents.control.correlation import HourlyMatrices, group_correlation
from agents.plan_parts import Neighbourhood, NodeNeighbourhoods
from agents.settings import StorageSettings
from bus_schemas.errors import InputError, not_one_of
from bus_schemas.tree import ROOT, ControlTree, check_name
from scenarios.scenario import ControlTable
from sim_plant.sites import Sites, east_north_m

_TIER_LETTERS: Final = "czar"
"""Clusters are c1, c2, ...; zones of clusters z1, ...; then areas and regions."""


def control_tree(
    control: ControlTable, sites: Sites, deviations: HourlyMatrices, hours: Sequence[int]
) -> ControlTree:
    """Cluster inverters, then clusters, and so on, by their mean correlation in these hours."""
    if (control.cluster_sizes is None) == (control.cluster_count is None):
        raise InputError.of(
            "control.cluster_sizes, cluster_count",
            "expected one of the two, got "
            f"{'neither' if control.cluster_count is None else 'both'}",
        )
    groups: list[tuple[int, ...]] = [(index,) for index in range(len(sites.names))]
    paths = list(sites.names)
    tiers: Sequence[Sequence[int] | int] = control.cluster_sizes or control.cluster_count or ()
    for tier, given in enumerate(tiers):
        sizes = _sizes(given, tier, len(groups))
        clusters = _choose(control, sizes, groups, sites, deviations, hours)
        groups = [
            tuple(leaf for place in cluster for leaf in groups[place]) for cluster in clusters
        ]
        letter = _TIER_LETTERS[tier] if tier < len(_TIER_LETTERS) else f"t{tier}_"
        for number, group in enumerate(groups, start=1):
            for leaf in group:
                paths[leaf] = f"{letter}{number}/{paths[leaf]}"
    order = [leaf for group in groups for leaf in group]
    return ControlTree(tuple((paths[leaf], float(sites.rating_kw[leaf])) for leaf in order))


def with_storages(tree: ControlTree, storages: Sequence[StorageSettings]) -> ControlTree:
    """Return the tree with storages at their places."""
    clusters, taken = [path for path in tree.parents if path], {*tree.nodes}
    for number, one in enumerate(storages):
        where = f"storage[{number}]"
        check_name(one.name, f"{where}.name")
        if one.cluster and one.cluster not in clusters:
            known = not_one_of(clusters, one.cluster, "no cluster, or ")
            raise InputError.of(f"{where}.cluster", known)
        if one.path in taken:
            expected = "a name that no other node has"
            raise InputError.of(f"{where}.name", f"expected {expected}, got {one.name}")
        taken.add(one.path)
    return replace(tree, storages=tuple((one.path, one.rating_kw) for one in storages))


def neighbourhoods(
    tree: ControlTree, deviations: HourlyMatrices, order: Sequence[int], began_ns: dict[int, int]
) -> tuple[NodeNeighbourhoods, ...]:
    """Return the correlation between each parent's children, from the beginning of each hour on.

    `order` has the column in the matrices of each inverter of the tree.
    """
    found = []
    for parent in tree.parents:
        groups = [
            [order[leaf] for leaf in tree.leaves_below(child)]
            for child in tree.children(parent)
            if not tree.is_storage(child)
        ]
        hours = []
        for hour, time_ns in sorted(began_ns.items()):
            rows = group_correlation(deviations[hour], groups).tolist()
            hours.append(Neighbourhood(time_ns, tuple(map(tuple, rows))))
        found.append(NodeNeighbourhoods(parent, tuple(hours)))
    return tuple(found)


def between(history_kw: Sequence[dict[int, NDArray[np.float64]]]) -> NodeNeighbourhoods:
    """Return the correlation between a fleet's plants, in the hours in which their pasts match."""
    hours, single = [], [(place,) for place in range(len(history_kw))]
    for time_ns in sorted(set[int]().union(*history_kw)):
        columns = [one[time_ns] for one in history_kw if time_ns in one]
        if len(columns) == len(history_kw) and len({*map(len, columns)}) == 1:
            rows = group_correlation(np.column_stack(columns), single).tolist()
            hours.append(Neighbourhood(time_ns, tuple(map(tuple, rows))))
    return NodeNeighbourhoods(ROOT, tuple(hours))


def _sizes(given: Sequence[int] | int, tier: int, members: int) -> Sequence[int]:
    """Sizes of the clusters of a tier, largest first where only their count is given."""
    if isinstance(given, int):
        if given > members:
            raise InputError(
                f"control.cluster_count[{tier}]: expected 1 to {members} clusters, got {given}"
            )
        smaller, larger = divmod(members, given)
        return (smaller + 1,) * larger + (smaller,) * (given - larger)
    if sum(given) != members:
        raise InputError(
            f"control.cluster_sizes[{tier}]: expected sizes that add up to {members}, got "
            f"{sum(given)}"
        )
    return given


def _choose(
    control: ControlTable,
    sizes: Sequence[int],
    groups: list[tuple[int, ...]],
    sites: Sites,
    deviations: HourlyMatrices,
    hours: Sequence[int],
) -> Sequence[Sequence[int]]:
    match control.clusters:
        case "correlation":
            return search_clusters(_mean_correlation(groups, deviations, hours), sizes)
        case "most-alike":
            return search_clusters(-_mean_correlation(groups, deviations, hours), sizes)
        case "geographic":
            return geographic_clusters(*_positions_m(groups, sites), sizes)
        case "random":
            return random_clusters(sizes, control.clusters_seed)
        case "listed":
            return [range(low, high) for low, high in pairwise(np.cumsum([0, *sizes]).tolist())]


def _mean_correlation(
    groups: list[tuple[int, ...]], deviations: HourlyMatrices, hours: Sequence[int]
) -> NDArray[np.float64]:
    """Return the correlation between groups, the mean of all hours that decide."""
    hourly = [group_correlation(deviations[hour], groups) for hour in hours]
    return np.asarray(np.mean(hourly, axis=0))


def _positions_m(
    groups: list[tuple[int, ...]], sites: Sites
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    east_m, north_m = east_north_m(sites.lat_deg, sites.lon_deg)
    return (
        np.array([east_m[list(group)].mean() for group in groups]),
        np.array([north_m[list(group)].mean() for group in groups]),
    )
