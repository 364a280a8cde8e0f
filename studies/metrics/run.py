"""All figures of merit of a run."""

from __future__ import annotations

from dataclasses import dataclass

from recordings.read.series import RunSeries
from studies.metrics.commitment import (
    CommitmentMetrics,
    HeadroomMetrics,
    commitment_metrics,
    headroom_metrics,
)
from studies.metrics.ramps import RampMetrics, ramp_metrics
from studies.metrics.regulation import (
    RegulationMetrics,
    regulation_metrics,
)
from studies.metrics.tracking import (
    SupportMileage,
    TrackingError,
    support_mileage,
    tracking_error,
)


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


def run_metrics(series: RunSeries) -> RunMetrics:
    """Work out the figures of merit of a run.

    Cycles whose dispatch or production is missing do not count. A ramp that begins or ends in one
    is left out, and so is a window of PJM's score that holds one.

    Raises
    ------
    ValueError
        The run has no cycle with both.
    """
    known = series.known
    if not known.any():
        raise ValueError("run: expected a cycle with dispatch and production, got none")
    desired_kw, possible_kw = series.desired_kw, series.possible_kw
    delivered_kw, cycle_s = series.delivered_kw, series.cycle_s
    rating_kw = float(series.rating_kw.sum())
    of_known = desired_kw[known], possible_kw[known], delivered_kw[known]
    return RunMetrics(
        commitment=commitment_metrics(*of_known, cycle_s),
        tracking=tracking_error(desired_kw[known], delivered_kw[known]),
        support=support_mileage(series.support_kw[known], cycle_s),
        headroom=headroom_metrics(series.commitment_kw[known], *of_known[1:], cycle_s),
        ramps=ramp_metrics(delivered_kw, rating_kw, cycle_s, series.ramp_limit_percent_per_min),
        regulation=regulation_metrics(series),
    )
