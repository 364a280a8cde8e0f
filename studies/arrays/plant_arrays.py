"""The plants of a fleet as arrays of numbers, and their part of the closed loop."""

from __future__ import annotations

from collections.abc import Iterable
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.control.allocation import total
from agents.control.correction import Correction, CorrectionLaw, corrected, corrected_kw
from agents.control.grid import GridLaw, desired_kw, net_kw, ramped_kw
from agents.plan import RunPlan


class PlantArrays(NamedTuple):
    """K plants of a fleet; the loop changes the state in place.

    of_node, of_inverter, of_storage: Plant of each node in `ControlArrays`, of each inverter and
        storage; -1: of none.
    grid, correction: The numbers of each `GridLaw` and `CorrectionLaw`, shape (K, ...).
    meter_error: Relative error of each meter, shape (K,).
    impp_kw, able_kw: What inverters, and storages, could give before losses, shape (K,).
    read_kw: What each meter reads, shape (K,).
    reference_kw: What is wanted of each, within its ramp limits, shape (K,).
    """

    of_node: NDArray[np.int64]
    of_inverter: NDArray[np.int64]
    of_storage: NDArray[np.int64]
    grid: NDArray[np.float64]
    correction: NDArray[np.float64]
    meter_error: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    able_kw: NDArray[np.float64]
    read_kw: NDArray[np.float64]
    reference_kw: NDArray[np.float64]


def plant_arrays(plan: RunPlan, number: dict[str, int], is_on: bool) -> PlantArrays:
    """Return the plants of a plan, whose nodes are numbered so; `is_on`: they are corrected."""
    names = [one.name for one in plan.plants]
    place = {name: at for at, name in enumerate(names)}

    def of(paths: Iterable[str]) -> NDArray[np.int64]:
        return np.array([place.get(path.partition("/")[0], -1) for path in paths], dtype=np.int64)

    laws = [plan.correction_law(name)._replace(is_on=is_on) for name in names]
    zeros = np.zeros((4, len(names)))
    return PlantArrays(
        of_node=np.array([place.get(path, -1) for path in number], dtype=np.int64),
        of_inverter=of(plan.tree.leaves),
        of_storage=of(plan.tree.storage_paths),
        grid=_numbers([plan.grid_laws[name] for name in names], len(GridLaw._fields)),
        correction=_numbers(laws, len(CorrectionLaw._fields)),
        meter_error=np.array([one.grid.meter_error_percent / 100.0 for one in plan.plants]),
        impp_kw=zeros[0],
        able_kw=zeros[1],
        read_kw=zeros[2],
        reference_kw=zeros[3] + nan,
    )


def _numbers(laws: list[GridLaw] | list[CorrectionLaw], width: int) -> NDArray[np.float64]:
    return np.array(laws, dtype=np.float64).reshape((len(laws), width))


def grid_law(plants: PlantArrays, plant: int) -> GridLaw:
    n = plants.grid[plant]
    return GridLaw(n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8], n[9], n[10], n[11])


def correction_law(plants: PlantArrays, plant: int, kept_turns: int) -> CorrectionLaw:
    n = plants.correction[plant]
    return CorrectionLaw(n[0] > 0.0, n[1], n[2], n[3], n[4], n[5] > 0.0, n[6], n[7], kept_turns)


def read_meters(
    plants: PlantArrays,
    power_kw: NDArray[np.float64],
    stored_kw: NDArray[np.float64],
    grid: GridLaw,
    meter_error: float,
) -> float:
    """Read the meters of all plants, and return what the whole feeds in."""
    if len(plants.read_kw) == 0:
        gross_kw = total(power_kw) + total(stored_kw)
        return net_kw(gross_kw, grid) * (1.0 + meter_error)
    for plant in range(len(plants.read_kw)):
        gross_kw = total(power_kw[plants.of_inverter == plant])
        gross_kw += total(stored_kw[plants.of_storage == plant])
        read_kw = net_kw(gross_kw, grid_law(plants, plant))
        plants.read_kw[plant] = read_kw * (1.0 + plants.meter_error[plant])
    beside_kw = total(stored_kw[plants.of_storage < 0])
    return net_kw(total(plants.read_kw) + beside_kw, grid) * (1.0 + meter_error)


def metered_kw(
    plants: PlantArrays, node: int, asked_kw: float, known: list[Correction], kept_turns: int
) -> float:
    """Return what a node is to give: of a plant, for the power that is asked at its meter."""
    plant = plants.of_node[node]
    if plant < 0:
        return asked_kw
    grid, law = grid_law(plants, plant), correction_law(plants, plant, kept_turns)
    reference_kw = ramped_kw(plants.reference_kw[plant], asked_kw, grid)
    plants.reference_kw[plant] = reference_kw
    with_stores_kw = net_kw(plants.impp_kw[plant] + plants.able_kw[plant], grid)
    wanted_kw = desired_kw(reference_kw, 0.0, with_stores_kw, grid)
    possible_kw = net_kw(plants.impp_kw[plant], grid)
    known[plant] = corrected(known[plant], wanted_kw, possible_kw, 0.0, law)
    return corrected_kw(known[plant], law, grid)
