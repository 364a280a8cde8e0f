"""Figures of merit of a run. `run_metrics` works all of them out; each part has its own file."""

from studies.metrics.commitment import CommitmentMetrics, commitment_metrics
from studies.metrics.headroom import HeadroomMetrics
from studies.metrics.mileage import SupportMileage
from studies.metrics.performance import HourScore, PerformanceScore
from studies.metrics.ramps import RampMetrics
from studies.metrics.regulation import RegulationMetrics, RequestsFulfilled
from studies.metrics.run import RunMetrics, run_metrics
from studies.metrics.tracking import TrackingError

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
