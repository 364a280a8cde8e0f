"""How well a plant kept its commitment, why it fell short, and what power was left.

Symbols: desired P_d, possible P_MPP (sum of the inverters' true maximum powers), delivered P,
commitment P_c (desired power without regulation), all in kW; dt, the length of a cycle in hours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True)
class CommitmentMetrics:
    """How well a plant kept its commitment. Energies in kWh.

    Attributes
    ----------
    desired_kwh, possible_kwh, delivered_kwh
        sum P_d dt, sum P_MPP dt, sum P dt.
    unsatisfied_kwh
        Shortfall, sum max(0, P_d - P) dt: the energy that support from elsewhere had to give.
    unavoidable_kwh
        sum max(0, P_d - P_MPP) dt: the part of it that no controller could have met.
    control_caused_kwh
        The rest of it.
    over_delivered_kwh
        sum max(0, P - P_d) dt.
    """

    desired_kwh: float
    possible_kwh: float
    delivered_kwh: float
    unsatisfied_kwh: float
    unavoidable_kwh: float
    control_caused_kwh: float
    over_delivered_kwh: float

    @property
    def satisfied_percent(self) -> float | None:
        """100 (1 - unsatisfied / desired); None where nothing was desired."""
        unsatisfied_percent = self.percent(self.unsatisfied_kwh)
        return None if unsatisfied_percent is None else 100.0 - unsatisfied_percent

    def percent(self, energy_kwh: float) -> float | None:
        """Return an energy in % of the desired energy; None where nothing was desired."""
        return 100.0 * energy_kwh / self.desired_kwh if self.desired_kwh > 0.0 else None


def commitment_metrics(
    desired_kw: ArrayLike, possible_kw: ArrayLike, delivered_kw: ArrayLike, cycle_s: float
) -> CommitmentMetrics:
    """Compute how well a plant kept its commitment.

    Parameters
    ----------
    desired_kw, possible_kw, delivered_kw
        The plant cycle by cycle, shape (T,).
    cycle_s
        Length of a cycle [s].
    """
    desired, possible, delivered = map(np.asarray, (desired_kw, possible_kw, delivered_kw))
    hours = cycle_s / 3600.0
    unsatisfied = np.maximum(desired - delivered, 0.0)
    unavoidable = np.maximum(desired - possible, 0.0)
    return CommitmentMetrics(
        desired_kwh=float(desired.sum()) * hours,
        possible_kwh=float(possible.sum()) * hours,
        delivered_kwh=float(delivered.sum()) * hours,
        unsatisfied_kwh=float(unsatisfied.sum()) * hours,
        unavoidable_kwh=float(unavoidable.sum()) * hours,
        control_caused_kwh=float((unsatisfied - unavoidable).sum()) * hours,
        over_delivered_kwh=float(np.maximum(delivered - desired, 0.0).sum()) * hours,
    )


@dataclass(frozen=True, slots=True)
class HeadroomMetrics:
    """What was left of the possible power.

    Attributes
    ----------
    headroom_kwh, mean_headroom_kw
        Headroom kept, sum max(0, P_MPP - P) dt, and its mean over the run.
    ancillary_potential_kwh
        sum max(0, P_MPP - P_c) dt: energy that regulation could have used. docs/metrics.md has
        what the paper leaves open here.
    """

    headroom_kwh: float
    mean_headroom_kw: float
    ancillary_potential_kwh: float


def headroom_metrics(
    commitment_kw: NDArray[np.float64],
    possible_kw: NDArray[np.float64],
    delivered_kw: NDArray[np.float64],
    cycle_s: float,
) -> HeadroomMetrics:
    """Compute the headroom of a run: arrays of shape (T,), T at least 1; a cycle's length [s]."""
    hours = cycle_s / 3600.0
    headroom_kw = np.maximum(possible_kw - delivered_kw, 0.0)
    return HeadroomMetrics(
        headroom_kwh=float(headroom_kw.sum()) * hours,
        mean_headroom_kw=float(headroom_kw.mean()),
        ancillary_potential_kwh=float(np.maximum(possible_kw - commitment_kw, 0.0).sum()) * hours,
    )
