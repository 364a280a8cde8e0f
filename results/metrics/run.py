"""The figures of merit of a run. docs/metrics.md has their definitions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings.read.series import RunSeries
from results.metrics.help import HelpMetrics, help_metrics
from results.metrics.regulation import RegulationMetrics, regulation_metrics

_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True)
class CommitmentMetrics:
    """How well a plant kept its commitment: energies of dispatch, available and delivered power.

    The shortfall is sum max(0, dispatch - delivered) dt. Unavoidable is the part of it that no
    controller could have met, sum max(0, dispatch - available) dt; control-caused the rest.
    """

    dispatched_kwh: float
    available_kwh: float
    delivered_kwh: float
    shortfall_kwh: float
    unavoidable_kwh: float
    control_caused_kwh: float
    over_delivered_kwh: float

    @property
    def satisfied_percent(self) -> float | None:
        """100 (1 - shortfall / dispatched); None where nothing was dispatched."""
        shortfall_percent = self.percent(self.shortfall_kwh)
        return None if shortfall_percent is None else 100.0 - shortfall_percent

    def percent(self, energy_kwh: float) -> float | None:
        """Return an energy in % of the dispatched energy; None where nothing was dispatched."""
        return 100.0 * energy_kwh / self.dispatched_kwh if self.dispatched_kwh > 0.0 else None


@dataclass(frozen=True, slots=True)
class TrackingError:
    """Root mean square and mean absolute error of delivered power against the dispatch."""

    rmse_kw: float
    mae_kw: float


@dataclass(frozen=True, slots=True)
class ShortfallMileage:
    """Mileage of the shortfall s = max(0, dispatch - delivered): sum |s(k+1) - s(k)|."""

    total_kw: float
    per_hour_kw: float
    per_minute_kw: float


@dataclass(frozen=True, slots=True)
class HeadroomMetrics:
    """What was available and not used: the headroom h = max(0, available - delivered).

    Curtailed is sum h dt; the ancillary potential is sum max(0, available - commitment) dt.
    """

    curtailed_kwh: float
    mean_headroom_kw: float
    ancillary_potential_kwh: float


@dataclass(frozen=True, slots=True)
class RampMetrics:
    """Changes of the delivered power over a minute, P(t + 60 s) - P(t), from every cycle on.

    Where 60 s is no multiple of the cycle, it is the change over the nearest number of cycles, at
    least one, as a rate per minute. A minute is above the limit if a larger ramp began in it.
    Without a limit what belongs to it is None.
    """

    largest_up_kw_per_min: float
    largest_down_kw_per_min: float
    limit_kw_per_min: float | None
    above_limit_percent: float | None

    @property
    def largest_kw_per_min(self) -> float:
        """The larger of rise and fall."""
        return max(self.largest_up_kw_per_min, self.largest_down_kw_per_min)


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """Figures of merit of a run.

    `ramps` is None for a run of a minute or less, `help` where no residuals are known. Only a run
    of agents in a study counts `missed_inputs` and `reverted_percent`.
    """

    commitment: CommitmentMetrics
    tracking: TrackingError
    mileage: ShortfallMileage
    headroom: HeadroomMetrics
    ramps: RampMetrics | None
    regulation: RegulationMetrics | None
    help: HelpMetrics | None = None
    missed_inputs: int | None = None
    reverted_percent: float | None = None


def run_metrics(series: RunSeries) -> RunMetrics:
    """Work out the figures of merit of a run.

    Cycles whose dispatch or production is missing do not count. A ramp that begins or ends in one
    is left out, and so is a window of PJM's score that holds one.

    Raises ValueError: The run has no cycle with both.
    """
    known = series.known
    if not known.any():
        raise ValueError("run: expected a cycle with dispatch and production, got none")
    dispatch_kw, available_kw = series.dispatch_kw[known], series.available_kw[known]
    delivered_kw, shortfall_kw = series.delivered_kw[known], series.shortfall_kw[known]
    hours = series.cycle_s / 3600.0
    error_kw = delivered_kw - dispatch_kw
    mileage_kw = float(np.abs(np.diff(shortfall_kw)).sum())
    run_hours = len(shortfall_kw) * series.cycle_s / 3600.0
    headroom_kw = np.maximum(available_kw - delivered_kw, 0.0)
    potential_kw = np.maximum(available_kw - series.commitment_kw[known], 0.0)
    limit = series.ramp_limit_percent_per_min
    rating_kw = float(series.rating_kw.sum())
    return RunMetrics(
        commitment=commitment_metrics(dispatch_kw, available_kw, delivered_kw, series.cycle_s),
        tracking=TrackingError(
            rmse_kw=float(np.sqrt(np.mean(error_kw**2))), mae_kw=float(np.mean(np.abs(error_kw)))
        ),
        mileage=ShortfallMileage(
            mileage_kw, mileage_kw / run_hours, mileage_kw / (60.0 * run_hours)
        ),
        headroom=HeadroomMetrics(
            curtailed_kwh=float(headroom_kw.sum()) * hours,
            mean_headroom_kw=float(headroom_kw.mean()),
            ancillary_potential_kwh=float(potential_kw.sum()) * hours,
        ),
        ramps=ramp_metrics(series.delivered_kw, rating_kw, series.cycle_s, limit),
        regulation=regulation_metrics(series),
        help=_help(series),
        missed_inputs=series.missed_inputs,
        reverted_percent=series.reverted_percent,
    )


def _help(series: RunSeries) -> HelpMetrics | None:
    residual_kw = series.residual_kw[np.isfinite(series.residual_kw).all(axis=1)]
    return help_metrics(residual_kw, series.inverters) if len(residual_kw) else None


def commitment_metrics(
    dispatch_kw: ArrayLike, available_kw: ArrayLike, delivered_kw: ArrayLike, cycle_s: float
) -> CommitmentMetrics:
    """Compute how well a plant kept its commitment from its power in each cycle, shape (T,)."""
    dispatch, available, delivered = map(np.asarray, (dispatch_kw, available_kw, delivered_kw))
    hours = cycle_s / 3600.0
    shortfall = np.maximum(dispatch - delivered, 0.0)
    unavoidable = np.maximum(dispatch - available, 0.0)
    return CommitmentMetrics(
        dispatched_kwh=float(dispatch.sum()) * hours,
        available_kwh=float(available.sum()) * hours,
        delivered_kwh=float(delivered.sum()) * hours,
        shortfall_kwh=float(shortfall.sum()) * hours,
        unavoidable_kwh=float(unavoidable.sum()) * hours,
        control_caused_kwh=float((shortfall - unavoidable).sum()) * hours,
        over_delivered_kwh=float(np.maximum(delivered - dispatch, 0.0).sum()) * hours,
    )


def ramp_metrics(
    delivered_kw: NDArray[np.float64],
    rating_kw: float,
    cycle_s: float,
    limit_percent_per_min: float | None = None,
) -> RampMetrics | None:
    """Compute the ramps of delivered power, shape (T,), NaN where unknown; None if there is none.

    The limit is in % of the rating per minute.
    """
    span = max(1, round(60.0 / cycle_s))
    if len(delivered_kw) <= span:
        return None
    ramp_kw_per_min = (delivered_kw[span:] - delivered_kw[:-span]) * (60.0 / (span * cycle_s))
    # By minute the largest ramp; minutes without any known one do not count.
    minute_begins = np.arange(0, len(ramp_kw_per_min), span)
    largest_kw_per_min = np.fmax.reduceat(np.abs(ramp_kw_per_min), minute_begins)
    largest_kw_per_min = largest_kw_per_min[np.isfinite(largest_kw_per_min)]
    if not len(largest_kw_per_min):
        return None
    limit_kw_per_min = above_percent = None
    if limit_percent_per_min is not None:
        limit_kw_per_min = rating_kw * limit_percent_per_min / 100.0
        # A plant that ramps exactly as fast as it may is not too fast by a rounding error.
        too_fast = largest_kw_per_min > limit_kw_per_min + _ROUNDING * rating_kw
        above_percent = 100.0 * float(too_fast.mean())
    return RampMetrics(
        largest_up_kw_per_min=max(0.0, float(np.nanmax(ramp_kw_per_min))),
        largest_down_kw_per_min=max(0.0, -float(np.nanmin(ramp_kw_per_min))),
        limit_kw_per_min=limit_kw_per_min,
        above_limit_percent=above_percent,
    )
