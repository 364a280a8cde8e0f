"""How often inverters in need got help inside their own cluster, and how often from above.

An inverter is in need if its residual (IMPP - request; paper, eq. 4) is negative. Its supervisor
settles that while the residuals of its own inverters add up to zero or more. Otherwise it asks its
parent, up to the central controller. So it all follows from the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CallsForHelp:
    """Cycles with a call for help, and those of them in which it reached the central controller.

    Attributes
    ----------
    needy
        Cycles in which an inverter was in need.
    central
        Those of them in which what was missing could not be settled below the central controller.
    """

    needy: int
    central: int

    @property
    def central_percent(self) -> float | None:
        """100 central / needy; None where nobody was in need."""
        return 100.0 * self.central / self.needy if self.needy else None


@dataclass(frozen=True, slots=True)
class HelpMetrics:
    """Where help was found. r(i, k) is the residual of inverter i in cycle k.

    By the plant, cycle k is needy if r(i, k) < 0 for any inverter, and reaches the central
    controller if the sum of r(i, k) over any cluster is below zero. By the cluster, the same is
    counted for each cluster on its own and added up. A cluster is all that is below one child of
    the central controller: what a tier in between has settled has not reached the top.

    The plant is sufficient in a cycle if the sum of r(i, k) over all inverters is not below zero.
    In all other cycles some cluster must lack power, however clusters are chosen.

    Attributes
    ----------
    cycles
        Cycles of the run.
    plant, clusters
        Counted by the plant and by the cluster, over all cycles.
    plant_sufficient, clusters_sufficient
        The same over the cycles in which the plant is sufficient.
    """

    cycles: int
    plant: CallsForHelp
    clusters: CallsForHelp
    plant_sufficient: CallsForHelp
    clusters_sufficient: CallsForHelp


def help_metrics(residual_kw: NDArray[np.float64], inverters: Sequence[str]) -> HelpMetrics:
    """Count where help was found in a run.

    Parameters
    ----------
    residual_kw
        Residual of each inverter in each cycle, finite, shape (T, n).
    inverters
        Paths of the n inverters in the control tree, such as `c2/inv07`: they tell the clusters.
    """
    needy, lacking = _by_cluster(residual_kw, inverters)
    plant_needy = np.logical_or.reduce(needy, axis=1)
    plant_lacking = np.logical_or.reduce(lacking, axis=1)
    sufficient = residual_kw.sum(axis=1) >= 0.0
    return HelpMetrics(
        cycles=len(residual_kw),
        plant=_calls(plant_needy, plant_lacking),
        clusters=_calls(needy, lacking),
        plant_sufficient=_calls(plant_needy[sufficient], plant_lacking[sufficient]),
        clusters_sufficient=_calls(needy[sufficient], lacking[sufficient]),
    )


def _by_cluster(
    residual_kw: NDArray[np.float64], inverters: Sequence[str]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each cluster has an inverter in need, and whether it lacks, each (T, clusters)."""
    members: dict[str, list[int]] = {}
    for place, path in enumerate(inverters):
        members.setdefault(path.split("/", 1)[0], []).append(place)
    of_cluster = [residual_kw[:, places] for places in members.values()]
    needy = np.column_stack([(of_one < 0.0).any(axis=1) for of_one in of_cluster])
    lacking = np.column_stack([of_one.sum(axis=1) < 0.0 for of_one in of_cluster])
    return needy, lacking


def _calls(needy: NDArray[np.bool_], lacking: NDArray[np.bool_]) -> CallsForHelp:
    # Only where somebody is in need can a sum be negative.
    return CallsForHelp(int(needy.sum()), int(lacking.sum()))
