"""Figures of merit of a run. `run_metrics` works all of them out; each part has its own file."""

from recordings.metrics.commitment import CommitmentMetrics, commitment_metrics
from recordings.metrics.headroom import HeadroomMetrics
from recordings.metrics.mileage import SupportMileage
from recordings.metrics.performance import HourScore, PerformanceScore
from recordings.metrics.ramps import RampMetrics
from recordings.metrics.regulation import RegulationMetrics, RequestsFulfilled
from recordings.metrics.run import RunMetrics, run_metrics
from recordings.metrics.tracking import TrackingError

__all__ = [
    "CommitmentMetrics",
    "HeadroomMetrics",
    "HourScore",
    "PerformanceScore",
    "RampMetrics",
    "RegulationMetrics",
    "RequestsFulfilled",
    "RunMetrics",
    "SupportMileage",
    "TrackingError",
    "commitment_metrics",
    "run_metrics",
]
