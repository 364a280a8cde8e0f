"""All figures of merit of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.read.series import RunSeries
from studies.metrics.commitment import CommitmentMetrics, commitment_metrics
from studies.metrics.headroom import HeadroomMetrics, headroom_metrics
from studies.metrics.mileage import SupportMileage, support_mileage
from studies.metrics.ramps import RampMetrics, ramp_metrics
from studies.metrics.regulation import (
    TOLERANCES_PERCENT,
    RegulationMetrics,
    regulation_metrics,
)
from studies.metrics.tracking import TrackingError, tracking_error


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """Figures of merit of a run; a part is None where the run does not define it.

    Attributes
    ----------
    commitment
        Energies, and how well the desired power (commitment and regulation) was met.
    tracking
        RMSE and MAE of delivered against desired power.
    support
        Mileage of the power that others gave.
    headroom
        Headroom kept, and the ancillary potential.
    ramps
        Ramps over a minute; None for a run that is shorter than that.
    regulation
        How well the regulation signal was followed; None if none was offered.
    """

    commitment: CommitmentMetrics
    tracking: TrackingError
    support: SupportMileage
    headroom: HeadroomMetrics
    ramps: RampMetrics | None
    regulation: RegulationMetrics | None


def run_metrics(
    series: RunSeries,
    *,
    offered: NDArray[np.bool_] | None = None,
    tolerances_percent: Sequence[float] = TOLERANCES_PERCENT,
) -> RunMetrics:
    """Work out the figures of merit of a run.

    Parameters
    ----------
    series
        The run.
    offered
        Whether the plant offered regulation in each cycle, shape (T,). By default it is read from
        the regulation itself.
    tolerances_percent
        Tolerances of a regulation request, in % of the plant's rating.

    Raises
    ------
    ValueError
        The run has no cycle, or a power in it is not a finite number.
    """
    if series.cycles == 0:
        raise ValueError("the run has no cycle, accepted is one with at least one")
    desired_kw, possible_kw = series.desired_kw, series.possible_kw
    delivered_kw, cycle_s = series.delivered_kw, series.cycle_s
    _check_finite(desired=desired_kw, possible=possible_kw, delivered=delivered_kw)
    rating_kw = float(series.rating_kw.sum())
    return RunMetrics(
        commitment=commitment_metrics(desired_kw, possible_kw, delivered_kw, cycle_s),
        tracking=tracking_error(desired_kw, delivered_kw),
        support=support_mileage(np.maximum(desired_kw - delivered_kw, 0.0), cycle_s),
        headroom=headroom_metrics(series.commitment_kw, possible_kw, delivered_kw, cycle_s),
        ramps=ramp_metrics(delivered_kw, rating_kw, cycle_s, series.ramp_limit_percent_per_min),
        regulation=regulation_metrics(series, offered, tolerances_percent),
    )


def _check_finite(**powers_kw: NDArray[np.float64]) -> None:
    for name, power_kw in powers_kw.items():
        bad = np.flatnonzero(~np.isfinite(power_kw))
        if bad.size:
            raise ValueError(
                f"{name} power in cycle {bad[0]} is {power_kw[bad[0]]}, accepted is a finite number"
            )
