"""Runs control schemes on one case of a comparison."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import cast, get_args

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from results.metrics import RunMetrics, run_metrics
from scenarios.preparation import Preparation, prepare
from studies.arrays.schemes import BOUNDS, ReferenceGroups, run_scheme
from studies.compare.by_agents import run_by_agents
from studies.compare.cases import Case, label


@dataclass(frozen=True, slots=True)
class SchemeResult:
    """Figures of merit of one scheme in one case; a bound has no actuator."""

    scheme: str
    actuator: Actuator | None
    metrics: RunMetrics


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The results of all schemes in one case, each with one actuator after the other."""

    columns: Mapping[str, object]
    schemes: tuple[SchemeResult, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SchemeChoice:
    """What is compared: names of `SCHEMES`, each with all actuators, or with the scenario's."""

    schemes: tuple[str, ...]
    groups: ReferenceGroups = field(default_factory=ReferenceGroups)
    actuators: tuple[Actuator, ...] = ()


def run_case(choice: SchemeChoice, case: Case) -> CaseResult:
    """Run the schemes on one case; InputError where one does not fit the plant or its data."""
    try:
        preparation = prepare(case.scenario, case.options, "study")
        results = tuple(result for result, _ in run_schemes(preparation, choice))
    except InputError as error:
        name = label(case.columns)
        raise InputError(f"{name}: {error}" if name else str(error)) from None
    return CaseResult(case.columns, results, remarks_of(preparation))


def run_schemes(
    preparation: Preparation, choice: SchemeChoice
) -> Iterator[tuple[SchemeResult, RunSeries]]:
    """Yield the result and the series of each scheme of a prepared run.

    Where the network has faults, the agents themselves run; otherwise arrays give the same. Only
    the hierarchical schemes have a network.

    Grouping control has its best, median and worst reference group, by control-caused plus
    over-delivered energy: a group that trades one for the other does not win.
    """

    def missed_kwh(run: tuple[RunMetrics, RunSeries]) -> float:
        energy = run[0].commitment
        return energy.control_caused_kwh + energy.over_delivered_kwh

    plan, profile = preparation.plan, preparation.profile
    actuators = choice.actuators or (plan.control.actuator,)
    for name in choice.schemes:
        for actuator in (None,) if name in BOUNDS else actuators:
            inverters = actuator or plan.control.actuator
            if plan.faults.rules and name in get_args(Scheme):
                series = [run_by_agents(plan, profile, cast(Scheme, name), inverters)]
            else:
                series = run_scheme(name, plan, profile, inverters, choice.groups)
            runs = sorted(((run_metrics(one), one) for one in series), key=missed_kwh)
            named = {name: runs[0]}
            if len(runs) > 1:
                ranks = {"best": 0, "median": len(runs) // 2, "worst": -1}
                named = {f"{name} {rank}": runs[place] for rank, place in ranks.items()}
            for its_name, (metrics, one) in named.items():
                title = f"{its_name}, {actuator}" if actuator and len(actuators) > 1 else its_name
                result = SchemeResult(its_name, actuator, metrics)
                yield result, dataclasses.replace(one, label=title)


def remarks_of(preparation: Preparation) -> tuple[str, ...]:
    """Return what a reader must know about the data of a study."""
    perfect = "Faults act on paper and predictive; the other schemes have no network."
    hindsight = "Clusters and neighbours were chosen from the run's own data: hindsight."
    more = [perfect] * bool(preparation.plan.faults.rules) + [hindsight] * preparation.hindsight
    return (*preparation.remarks, *more)
