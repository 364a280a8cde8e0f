"""A run's control tree as arrays of numbers, for the closed loop to walk through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.control.neighbours import help_order
from agents.plan import RunPlan
from bus_schemas.tree import ROOT, depth


@dataclass(frozen=True, slots=True, eq=False)
class ControlArrays:
    """N nodes, of which the first n are the inverters; P parents; H hours of virtual neighbours.

    Attributes
    ----------
    rating_kw
        AC rating of each node, shape (N,).
    parents
        Node number of each parent, the root first and each before its children, shape (P,).
    children
        Node numbers of each parent's children, filled up with -1, shape (P, C).
    period
        Every how many cycles each parent acts, shape (P,).
    rests
        Whether the children of each parent act between its turns, shape (P,).
    order
        For each hour, parent and child the places of its siblings in the order of help, shape
        (H, P, C, C - 1); -1 where there is none.
    hour
        Row in `order` that holds in each cycle, shape (cycles,).
    """

    rating_kw: NDArray[np.float64]
    parents: NDArray[np.int64]
    children: NDArray[np.int64]
    period: NDArray[np.int64]
    rests: NDArray[np.bool_]
    order: NDArray[np.int64]
    hour: NDArray[np.int64]


def control_arrays(plan: RunPlan, cycles: int) -> ControlArrays:
    """Return a plan's control tree with its nodes numbered.

    Parameters
    ----------
    plan
        The run.
    cycles
        How many of its cycles are wanted.
    """
    tree = plan.tree
    parent_paths = sorted(tree.parents, key=lambda path: (path != ROOT, depth(path)))
    number = {path: place for place, path in enumerate([*tree.leaves, *parent_paths])}
    widest = max(len(tree.children(path)) for path in parent_paths)
    children = np.full((len(parent_paths), widest), -1, dtype=np.int64)
    for row, path in enumerate(parent_paths):
        below = [number[child] for child in tree.children(path)]
        children[row, : len(below)] = below
    period = [plan.periods.cycles[depth(path)] for path in parent_paths]
    times_ns = sorted({hood.from_time_ns for entry in plan.neighbourhoods for hood in entry.hours})
    sim_time_ns = plan.start_time_ns + plan.cycle_ns * np.arange(cycles, dtype=np.int64)
    hour = np.maximum(np.searchsorted(times_ns, sim_time_ns, side="right") - 1, 0)
    return ControlArrays(
        rating_kw=np.array([tree.rating_kw(path) for path in number]),
        parents=np.array([number[path] for path in parent_paths], dtype=np.int64),
        children=children,
        period=np.array(period, dtype=np.int64),
        rests=np.array([plan.periods.rests_between(path) for path in parent_paths]),
        order=_orders(plan, parent_paths, widest, times_ns),
        hour=hour.astype(np.int64),
    )


def _orders(
    plan: RunPlan, parent_paths: list[str], widest: int, times_ns: list[int]
) -> NDArray[np.int64]:
    shape = (max(len(times_ns), 1), len(parent_paths), widest, max(widest - 1, 1))
    orders = np.full(shape, -1, dtype=np.int64)
    for row, path in enumerate(parent_paths):
        count = len(plan.tree.children(path))
        hoods = plan.neighbourhoods_of(path)
        for hour in range(shape[0]):
            known = [hood for hood in hoods if not times_ns or hood.from_time_ns <= times_ns[hour]]
            correlation = (known or list(hoods[:1]))[-1].correlation if hoods else None
            siblings = help_order(correlation or [[0.0] * count] * count)
            for child, asked in enumerate(siblings):
                orders[hour, row, child, : len(asked)] = asked
    return orders
