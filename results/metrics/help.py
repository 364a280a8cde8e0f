"""How often inverters in need got help inside their own cluster, and how often from above.

An inverter is in need if its residual (IMPP - share; paper, eq. 4) is negative. Its supervisor
can help while the residuals of its own inverters add up to zero or more. Otherwise it asks its
parent, up to the central controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class HelpMetrics:
    """Where help was found. r(i, k) is the residual of inverter i in cycle k.

    Cycle k is needy if r(i, k) < 0 for any inverter. It is settled outside a cluster if the sum of
    r(i, k) over any cluster is below zero: its supervisor must ask the central controller. A
    cluster is all that is below one child of the central controller: what a tier in between has
    settled has not reached the top.

    `_able` counts only cycles in which the sum of r(i, k) over all inverters is not below zero. In
    all others some cluster must lack power, however clusters are chosen.
    """

    needy: int
    outside: int
    needy_able: int
    outside_able: int

    @property
    def outside_percent(self) -> float | None:
        """100 outside / needy; None where nobody was in need."""
        return 100.0 * self.outside / self.needy if self.needy else None

    @property
    def outside_able_percent(self) -> float | None:
        return 100.0 * self.outside_able / self.needy_able if self.needy_able else None


def help_metrics(residual_kw: NDArray[np.float64], inverters: Sequence[str]) -> HelpMetrics:
    """Count where help was found in a run.

    `residual_kw` has the residual of each inverter in each cycle, finite, shape (T, n). The paths
    of the n inverters in the control tree tell the clusters.
    """
    members: dict[str, list[int]] = {}
    for column, path in enumerate(inverters):
        members.setdefault(path.split("/", 1)[0], []).append(column)
    needy = (residual_kw < 0.0).any(axis=1)
    clusters_kw = [residual_kw[:, columns].sum(axis=1) for columns in members.values()]
    outside = needy & (np.min(clusters_kw, axis=0) < 0.0)
    able = residual_kw.sum(axis=1) >= 0.0
    counts = (needy, outside, needy & able, outside & able)
    return HelpMetrics(*(int(count.sum()) for count in counts))
