"""Figures of merit of a run. `run_metrics` computes all of them; docs/metrics.md defines them."""

from results.metrics.run import CommitmentMetrics, RunMetrics, commitment_metrics, run_metrics

__all__ = ["CommitmentMetrics", "RunMetrics", "commitment_metrics", "run_metrics"]
