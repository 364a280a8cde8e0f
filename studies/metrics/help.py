"""How often inverters in need were helped by their own cluster, and how often central had to be.

An inverter is in need in a cycle if its residual (IMPP less request; paper, eq. 4) is negative. Its
supervisor settles that among its own inverters as long as their residuals add up to no less than
zero. If they add up to less, the supervisor asks its parent; what no parent below the central
controller can settle reaches the central controller. So it all follows from the residuals.
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

    Counted in two ways, each for all cycles and for those in which the central controller could
    help at all:

    - By the plant: cycle k is needy if r(i, k) < 0 for any inverter i of the plant. It reaches the
      central controller if sum of r(i, k) over i in C < 0 for at least one cluster C.
    - By the cluster: cycle k of cluster C is needy if r(i, k) < 0 for any i in C. It reaches the
      central controller if sum of r(i, k) over i in C < 0. Cycles of all clusters are added up.

    The plant is sufficient in a cycle if sum of r(i, k) over all its inverters >= 0: by their own
    estimates they have what is asked for. In all other cycles at least one cluster must lack,
    however clusters are chosen, and the central controller has nothing to give.

    A cluster is all that is below one child of the central controller. With more than three tiers
    these are the largest ones: what a tier in between has settled has not reached the top.

    Attributes
    ----------
    cycles
        Cycles of the run.
    plant, clusters
        Counted by the plant and by the cluster, over all cycles.
    plant_sufficient, clusters_sufficient
        The same over those cycles in which the plant is sufficient.
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
        Residual of each inverter in each cycle, shape (T, n).
    inverters
        Paths of the n inverters in the control tree, such as `c1/inv07`: they tell the clusters.

    Raises
    ------
    ValueError
        Shapes differ, or a residual is not a finite number (a scheme without residuals).
    """
    if residual_kw.ndim != 2 or residual_kw.shape[1] != len(inverters):
        raise ValueError(
            f"residuals: expected shape (T, {len(inverters)}), got {residual_kw.shape}"
        )
    if not np.isfinite(residual_kw).all():
        row, column = np.argwhere(~np.isfinite(residual_kw))[0]
        raise ValueError(
            f"residual of {inverters[column]} in cycle {row}: expected a finite number, "
            f"got {residual_kw[row, column]}"
        )
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
