"""Results of schemes with the figures of merit that a test needs, written down one by one."""

from __future__ import annotations

from collections.abc import Mapping

from agents.plan import Actuator
from studies.compare.study import CaseResult, SchemeResult
from studies.metrics import CommitmentMetrics, RunMetrics, SupportMileage, TrackingError
from studies.metrics.commitment import HeadroomMetrics


def result(
    scheme: str,
    actuator: Actuator | None,
    caused: float,
    beyond: float = 0.0,
    rmse_kw: float = 0.0,
) -> SchemeResult:
    """A scheme that was to deliver 100 kWh: its energies are per cents."""
    energy = CommitmentMetrics(
        desired_kwh=100.0,
        possible_kwh=200.0,
        delivered_kwh=100.0 - caused + beyond,
        unsatisfied_kwh=caused,
        unavoidable_kwh=0.0,
        control_caused_kwh=caused,
        over_delivered_kwh=beyond,
    )
    metrics = RunMetrics(
        commitment=energy,
        tracking=TrackingError(rmse_kw, 0.0),
        support=SupportMileage(0.0, 0.0, 0.0),
        headroom=HeadroomMetrics(0.0, 0.0, 0.0),
        ramps=None,
        regulation=None,
    )
    return SchemeResult(scheme, actuator, metrics)


def case(label: str, caused: Mapping[str, float], settings: str = "") -> CaseResult:
    """A case with the fraction actuator: control-caused shortfall of each scheme in %."""
    schemes = tuple(result(scheme, "fraction", value) for scheme, value in caused.items())
    return CaseResult(label, settings, schemes, 0.0, 0.0, ())
