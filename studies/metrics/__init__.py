"""Figures of merit of a run. `run_metrics` computes all of them; docs/metrics.md defines them."""

from studies.metrics.commitment import CommitmentMetrics, HeadroomMetrics, commitment_metrics
from studies.metrics.performance import HourScore, PerformanceScore
from studies.metrics.ramps import RampMetrics
from studies.metrics.regulation import RegulationMetrics, RequestsFulfilled
from studies.metrics.run import RunMetrics, run_metrics
from studies.metrics.tracking import SupportMileage, TrackingError

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
