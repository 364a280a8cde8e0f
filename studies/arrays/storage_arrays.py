"""A run's storages as arrays of numbers, and their part of the closed loop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.control.allocation import total
from agents.control.fleet import feedable_ability
from agents.control.storage import (
    Ability,
    Course,
    Pursuit,
    StorageLaw,
    ability,
    asked_kw,
    moved,
    next_course,
    parts_kw,
    storage_kw,
)
from agents.plan import RunPlan
from bus_schemas.tree import ROOT
from sim_plant.storage import Storages
from studies.arrays.plant_arrays import PlantArrays, grid_law


class StorageArrays(NamedTuple):
    """M storages, and S nodes that are one or have some below; the loop changes the state in place.

    Nodes are numbered from the root down, so that those of a parent follow each other.

    laws: The numbers of each `StorageLaw`, shape (M, 9).
    node: Node of each storage, shape (M,).
    row: Row in `ControlArrays.parents` of each parent with nodes, the root first, shape (P,).
    own: Node of each of these parents, shape (P,); -1 for the root.
    first, end: Their nodes: the first one, and the number after the last, shape (P,).
    in_tree: Number in `ControlArrays` of each node, shape (S,); -1 of a storage.
    able: What the storages of each node can do, shape (S, 3).
    asked_kw: What they are asked for, shape (S,).
    ordered_kw: The last commands in turn, shape (longest delay + 1, M), and `delay_cycles`.
    energy_kwh, power_kw: Of each storage now, shape (M,).
    energies_kwh, powers_kw: In each cycle so far, shape (cycles, M).
    """

    laws: NDArray[np.float64]
    node: NDArray[np.int64]
    row: NDArray[np.int64]
    own: NDArray[np.int64]
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    in_tree: NDArray[np.int64]
    able: NDArray[np.float64]
    asked_kw: NDArray[np.float64]
    ordered_kw: NDArray[np.float64]
    delay_cycles: NDArray[np.int64]
    energy_kwh: NDArray[np.float64]
    power_kw: NDArray[np.float64]
    energies_kwh: NDArray[np.float64]
    powers_kw: NDArray[np.float64]


def storage_arrays(
    plan: RunPlan, cycles: int, number: dict[str, int], parents: list[str]
) -> StorageArrays:
    """Return the storages of a plan; nodes and parents are numbered as in its `ControlArrays`."""
    tree, nodes = plan.tree, list[str]()
    with_some = [path for path in parents if tree.storage_kw(path)]
    first = []
    for path in with_some:
        first.append(len(nodes))
        nodes += [child for child in tree.children(path) if tree.storage_kw(child)]
    storages = Storages(plan)
    stores, count = storages.at_rest(), len(nodes)
    kept = 1 + max(storages.delay_cycles, default=0)
    return StorageArrays(
        laws=np.array(storages.laws).reshape((len(stores), len(StorageLaw._fields))),
        node=_numbers(nodes.index(path) for path in tree.storage_paths),
        row=_numbers(parents.index(path) for path in with_some),
        own=_numbers(-1 if path == ROOT else nodes.index(path) for path in with_some),
        first=_numbers(first),
        end=_numbers([*first[1:], count]),
        in_tree=_numbers(number.get(path, -1) for path in nodes),
        able=np.zeros((count, len(Ability._fields))),
        asked_kw=np.zeros(count),
        ordered_kw=np.zeros((kept, len(stores))),
        delay_cycles=_numbers(storages.delay_cycles),
        energy_kwh=np.array([store.energy_kwh for store in stores]),
        power_kw=np.zeros(len(stores)),
        energies_kwh=np.zeros((cycles, len(stores))),
        powers_kw=np.zeros((cycles, len(stores))),
    )


def _numbers(values: Iterable[int]) -> NDArray[np.int64]:
    return np.array(list(values), dtype=np.int64)


def law_of(storages: StorageArrays, storage: int) -> StorageLaw:
    law = storages.laws[storage]
    return StorageLaw(law[0], law[1], law[2], law[3], law[4], law[5], law[6], law[7], law[8])


def state_abilities(storages: StorageArrays, plants: PlantArrays) -> Ability:
    """Let storages and parents state what can be done; return it for the plant as a whole."""
    able, together = storages.able, Ability(0.0, 0.0, 0.0)
    for storage in range(len(storages.node)):
        one = ability(
            storages.energy_kwh[storage], storages.power_kw[storage], law_of(storages, storage)
        )
        at = storages.node[storage]
        able[at, 0], able[at, 1], able[at, 2] = one.discharge_kw, one.absorb_kw, one.charge_kw
    for parent in range(len(storages.row) - 1, -1, -1):
        below = able[storages.first[parent] : storages.end[parent]]
        together = Ability(total(below[:, 0]), total(below[:, 1]), total(below[:, 2]))
        if storages.own[parent] >= 0:
            own = storages.own[parent]
            plant = plants.of_node[storages.in_tree[own]]
            if plant >= 0:
                plants.able_kw[plant] = together.discharge_kw
                grid = grid_law(plants, plant)
                together = feedable_ability(plants.impp_kw[plant], together, grid)
            able[own, 0], able[own, 1] = together.discharge_kw, together.absorb_kw
            able[own, 2] = together.charge_kw
    return together


def ask_storages(
    storages: StorageArrays,
    target_kw: float,
    impp_kw: float,
    error_kw: float,
    able: Ability,
    course: Course,
    pursuit: Pursuit,
    helps_first: bool,
) -> tuple[float, Course]:
    """Divide a target in a turn of the root; return what the inverters are asked for."""
    inverters_kw = asked_kw(target_kw, impp_kw, error_kw, able)
    course = next_course(course, inverters_kw, impp_kw, pursuit)
    power_kw = storage_kw(target_kw, impp_kw, course.coming_kw, able, helps_first)
    if len(storages.row) > 0:
        divide(storages, 0, power_kw)
    return inverters_kw, course


def divide(storages: StorageArrays, parent: int, power_kw: float) -> float:
    """Divide a power among the storages of a parent; return what they are asked for together."""
    first, end = storages.first[parent], storages.end[parent]
    parts = parts_kw(power_kw, storages.able[first:end, 0], storages.able[first:end, 1])
    for place in range(end - first):
        storages.asked_kw[first + place] = parts[place]
    return total(parts)


def obey_storages(storages: StorageArrays, cycle: int) -> None:
    """Let each storage do in a cycle what it is asked for."""
    kept = len(storages.ordered_kw)
    for storage in range(len(storages.node)):
        storages.ordered_kw[cycle % kept, storage] = storages.asked_kw[storages.node[storage]]
        obeyed = (cycle - storages.delay_cycles[storage]) % kept
        storages.power_kw[storage], storages.energy_kwh[storage] = moved(
            storages.energy_kwh[storage],
            storages.power_kw[storage],
            storages.ordered_kw[obeyed, storage],
            law_of(storages, storage),
        )
    storages.powers_kw[cycle], storages.energies_kwh[cycle] = storages.power_kw, storages.energy_kwh
