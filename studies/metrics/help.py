"""How often inverters in need got help inside their own cluster, and how often from above.

An inverter is in need if its residual (IMPP - request; paper, eq. 4) is negative. Its supervisor
can help while the residuals of its own inverters add up to zero or more. Otherwise it asks its
parent, up to the central controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CallsForHelp:
    """Cycles with an inverter in need, and those of them in which its call reached the top."""

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
    """

    cycles: int
    plant: CallsForHelp
    clusters: CallsForHelp
    plant_sufficient: CallsForHelp
    clusters_sufficient: CallsForHelp


def help_metrics(residual_kw: NDArray[np.float64], inverters: Sequence[str]) -> HelpMetrics:
    """Count where help was found in a run.

    `residual_kw` has the residual of each inverter in each cycle, finite, shape (T, n). The paths
    of the n inverters in the control tree tell the clusters.
    """
    members: dict[str, list[int]] = {}
    for place, path in enumerate(inverters):
        members.setdefault(path.split("/", 1)[0], []).append(place)
    of_cluster = [residual_kw[:, places] for places in members.values()]
    needy = np.column_stack([(of_one < 0.0).any(axis=1) for of_one in of_cluster])
    lacking = np.column_stack([of_one.sum(axis=1) < 0.0 for of_one in of_cluster])
    plant = np.logical_or.reduce(needy, axis=1), np.logical_or.reduce(lacking, axis=1)
    sufficient = residual_kw.sum(axis=1) >= 0.0
    return HelpMetrics(
        cycles=len(residual_kw),
        plant=_calls(*plant),
        clusters=_calls(needy, lacking),
        plant_sufficient=_calls(*(of_plant[sufficient] for of_plant in plant)),
        clusters_sufficient=_calls(needy[sufficient], lacking[sufficient]),
    )


def _calls(needy: NDArray[np.bool_], lacking: NDArray[np.bool_]) -> CallsForHelp:
    # Only where somebody is in need can a sum be negative.
    return CallsForHelp(int(needy.sum()), int(lacking.sum()))
