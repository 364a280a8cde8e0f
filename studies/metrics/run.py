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

    Cycles without their dispatch or production do not count.

    Raises
    ------
    ValueError
        The run has no cycle with both.
    """
    if not series.known.any():
        raise ValueError("the run has no cycle with dispatch and production, expected at least one")
    if offered is not None:
        offered = offered[series.known]
    series = series.only_known()
    desired_kw, possible_kw = series.desired_kw, series.possible_kw
    delivered_kw, cycle_s = series.delivered_kw, series.cycle_s
    rating_kw = float(series.rating_kw.sum())
    return RunMetrics(
        commitment=commitment_metrics(desired_kw, possible_kw, delivered_kw, cycle_s),
        tracking=tracking_error(desired_kw, delivered_kw),
        support=support_mileage(np.maximum(desired_kw - delivered_kw, 0.0), cycle_s),
        headroom=headroom_metrics(series.commitment_kw, possible_kw, delivered_kw, cycle_s),
        ramps=ramp_metrics(delivered_kw, rating_kw, cycle_s, series.ramp_limit_percent_per_min),
        regulation=regulation_metrics(series, offered, tolerances_percent),
    )
