"""A run's control tree as arrays of numbers, for the closed loop to walk through."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.control.allocation import help_order
from agents.plan import RunPlan
from agents.settings import Scheme
from bus_schemas.tree import ROOT, depth
from studies.arrays.plant_arrays import PlantArrays, plant_arrays
from studies.arrays.storage_arrays import StorageArrays, storage_arrays


class ControlArrays(NamedTuple):
    """N nodes, P parents, n inverters, H hours of virtual neighbours.

    Nodes are numbered from the root down, so that the children of a parent follow each other.

    rating_kw: AC rating of each node, shape (N,).
    sharing_kw: That by which each inverter shares the dispatch, shape (n,).
    inverters: Node number of each inverter, in the plant's order, shape (n,).
    parents: Node number of each parent, the root first and each before its children, shape (P,).
    first, end: Node number of each parent's first child, and the number after its last, shape (P,).
    period: Every how many cycles each parent acts, shape (P,).
    order: For each hour, parent and child the places of its siblings in the order of help, shape
        (H, P, C, C - 1); -1 where there is none.
    hour: Row in `order` that holds in each cycle, shape (cycles,).
    """

    rating_kw: NDArray[np.float64]
    sharing_kw: NDArray[np.float64]
    inverters: NDArray[np.int64]
    parents: NDArray[np.int64]
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    period: NDArray[np.int64]
    order: NDArray[np.int64]
    hour: NDArray[np.int64]


def control_arrays(
    plan: RunPlan, cycles: int, is_on: bool
) -> tuple[ControlArrays, StorageArrays, PlantArrays]:
    """Return a plan's tree, storages and plants; `is_on`: targets are corrected by meters."""
    tree = plan.tree
    number = {ROOT: 0}
    parents: list[str] = []
    ends: list[int] = []
    children: list[int] = []
    waiting = deque([ROOT])
    while waiting:
        path = waiting.popleft()
        if children_of := [child for child in tree.children(path) if not tree.is_storage(child)]:
            number |= {child: place for place, child in enumerate(children_of, len(number))}
            parents.append(path)
            ends.append(len(number))
            children.append(len(children_of))
            waiting.extend(children_of)
    times_ns = sorted(
        {hood.from_time_ns for entry in plan.control.neighbourhoods for hood in entry.hours}
    )
    sim_time_ns = plan.timing.start_time_ns + plan.timing.cycle_ns * np.arange(
        cycles, dtype=np.int64
    )
    hour = np.maximum(np.searchsorted(times_ns, sim_time_ns, side="right") - 1, 0)
    arrays = ControlArrays(
        rating_kw=np.array([tree.rating_kw(path) for path in number]),
        sharing_kw=np.array([tree.sharing_kw(leaf) for leaf in tree.leaves]),
        inverters=np.array([number[leaf] for leaf in tree.leaves], dtype=np.int64),
        parents=np.array([number[path] for path in parents], dtype=np.int64),
        first=np.array(ends, dtype=np.int64) - np.array(children, dtype=np.int64),
        end=np.array(ends, dtype=np.int64),
        period=np.array(
            [plan.control.periods.cycles[depth(path)] for path in parents], dtype=np.int64
        ),
        order=_orders(plan, parents, children, times_ns),
        hour=hour.astype(np.int64),
    )
    plants = plant_arrays(plan, number, is_on)
    return arrays, storage_arrays(plan, cycles, number, parents), plants


def is_corrected(plan: RunPlan, scheme: Scheme) -> bool:
    """Whether a scheme corrects its target by the meter.

    The plan decides for its own scheme; of the others, only `predictive` does.
    """
    return plan.control.correction if scheme == plan.control.scheme else scheme == "predictive"


def _orders(
    plan: RunPlan, parent_paths: list[str], counts: list[int], times_ns: list[int]
) -> NDArray[np.int64]:
    widest = max(counts)
    shape = (max(len(times_ns), 1), len(parent_paths), widest, max(widest - 1, 1))
    orders = np.full(shape, -1, dtype=np.int64)
    for row, (path, count) in enumerate(zip(parent_paths, counts, strict=True)):
        hoods = plan.control.neighbourhoods_of(path)
        for hour in range(shape[0]):
            known = [hood for hood in hoods if not times_ns or hood.from_time_ns <= times_ns[hour]]
            correlation = (known or list(hoods[:1]))[-1].correlation if hoods else None
            siblings = help_order(correlation or [[0.0] * count] * count)
            for child, asked in enumerate(siblings):
                orders[hour, row, child, : len(asked)] = asked
    return orders
