"""Runs control schemes on one case of a comparison."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field

from agents.settings import Actuator
from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import Preparation, prepare
from recordings.read.series import RunSeries
from studies.arrays.schemes import BOUNDS, ReferenceGroups, run_scheme
from studies.compare.cases import Case
from studies.metrics import RunMetrics, run_metrics


@dataclass(frozen=True, slots=True)
class SchemeResult:
    """Figures of merit of one scheme in one case; a bound has no actuator."""

    scheme: str
    actuator: Actuator | None
    metrics: RunMetrics


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The results of all schemes in one case, each with one actuator after the other."""

    label: str
    settings: str
    schemes: tuple[SchemeResult, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is compared: names of `SCHEMES`, each with all actuators, or with the scenario's."""

    schemes: tuple[str, ...]
    groups: ReferenceGroups = field(default_factory=ReferenceGroups)
    actuators: tuple[Actuator, ...] = ()


def run_case(comparison: Comparison, case: Case) -> CaseResult:
    """Run the schemes on one case; InputError where one does not fit the plant or its data."""
    try:
        preparation = prepare(case.scenario, case.options, "study")
        found = tuple(result for result, _ in results_of(preparation, comparison))
    except InputError as error:
        raise InputError(f"{case.label}: {error}" if case.label else str(error)) from None
    return CaseResult(case.label, case.settings, found, remarks_of(preparation))


def results_of(
    preparation: Preparation, comparison: Comparison
) -> Iterator[tuple[SchemeResult, RunSeries]]:
    """Yield the result and the series of each scheme of a prepared run.

    Grouping control has its best, median and worst reference group, by control-caused plus
    over-delivered energy: a group that trades one for the other does not win.
    """

    def missed_kwh(found: tuple[RunMetrics, RunSeries]) -> float:
        energy = found[0].commitment
        return energy.control_caused_kwh + energy.over_delivered_kwh

    plan, profile = preparation.plan, preparation.profile
    actuators = comparison.actuators or (plan.actuator,)
    for name in comparison.schemes:
        for actuator in (None,) if name in BOUNDS else actuators:
            series = run_scheme(name, plan, profile, actuator or plan.actuator, comparison.groups)
            found = sorted(((run_metrics(one), one) for one in series), key=missed_kwh)
            ranks = {name: 0}
            if len(found) > 1:
                ranks = {f"{name} best": 0, f"{name} median": len(found) // 2, f"{name} worst": -1}
            for label, place in ranks.items():
                metrics, one = found[place]
                title = f"{label}, {actuator}" if actuator and len(actuators) > 1 else label
                result = SchemeResult(label, actuator, metrics)
                yield result, dataclasses.replace(one, label=title)


def remarks_of(preparation: Preparation) -> tuple[str, ...]:
    """Return what a reader must know about the data of a study over arrays."""
    perfect = "The faults of the scenario are left out: here the network is perfect."
    hindsight = "Clusters and neighbours were chosen from the run's own data: hindsight."
    more = [perfect] * bool(preparation.plan.faults) + [hindsight] * preparation.hindsight
    return (*preparation.remarks, *more)
