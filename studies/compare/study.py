"""Runs control schemes on one case of a comparison."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import Preparation, prepare
from recordings.read.series import RunSeries
from studies.arrays.schemes import ReferenceGroups, run_scheme
from studies.compare.cases import Case
from studies.metrics import RunMetrics, run_metrics


@dataclass(frozen=True, slots=True)
class SchemeResult:
    """Figures of merit of one scheme in one case."""

    scheme: str
    metrics: RunMetrics


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The results of all schemes in one case.

    Attributes
    ----------
    label
        Of the case.
    schemes
        In the order asked for. Grouping control has three: its best, median and worst reference
        group by control-caused shortfall.
    prepare_s, run_s
        Time to work out sky and market, and to run all schemes [s].
    remarks
        What a reader must know about the data.
    """

    label: str
    schemes: tuple[SchemeResult, ...]
    prepare_s: float
    run_s: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is compared: names of `SCHEMES`, and reference groups of grouping control."""

    schemes: tuple[str, ...]
    groups: ReferenceGroups = field(default_factory=ReferenceGroups)


def run_case(comparison: Comparison, case: Case) -> CaseResult:
    """Run the schemes on one case.

    Raises
    ------
    InputError
        The case does not fit its data, or a scheme does not fit the plant.
    """
    began = time.perf_counter()
    try:
        preparation = prepare(case.scenario, case.options, "study")
        prepared = time.perf_counter()
        found = tuple(
            SchemeResult(label, metrics)
            for label, metrics, _ in results_of(preparation, comparison)
        )
    except InputError as error:
        raise InputError(f"{case.label}: {error}" if case.label else str(error)) from None
    done = time.perf_counter()
    return CaseResult(case.label, found, prepared - began, done - prepared, remarks_of(preparation))


def results_of(
    preparation: Preparation, comparison: Comparison
) -> Iterator[tuple[str, RunMetrics, RunSeries]]:
    """Yield label, figures of merit and series of each scheme of a prepared run."""
    plan, profile = preparation.plan, preparation.profile
    for name in comparison.schemes:
        series = run_scheme(name, plan, profile, plan.actuator, comparison.groups)
        found = [(run_metrics(one), one) for one in series]
        if len(found) == 1:
            yield name, *found[0]
            continue
        found.sort(key=lambda pair: pair[0].commitment.control_caused_kwh)
        for rank, place in (("best", 0), ("median", len(found) // 2), ("worst", -1)):
            label = f"{name} {rank}"
            metrics, one = found[place]
            yield label, metrics, dataclasses.replace(one, label=label)


def remarks_of(preparation: Preparation) -> tuple[str, ...]:
    """Return what a reader must know about the data of a run."""
    if not preparation.hindsight:
        return preparation.remarks
    hindsight = "Clusters and neighbours were chosen from the run's own data: hindsight."
    return (*preparation.remarks, hindsight)
