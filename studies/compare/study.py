"""Runs control schemes on one case of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeAlias, cast, get_args

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from results.figures import Figures, run_figures
from scenarios.preparation import Preparation, prepare
from studies.arrays.schemes import BOUNDS, run_scheme
from studies.compare.by_agents import run_by_agents
from studies.compare.cases import Case, label

Row: TypeAlias = dict[str, Any]
"""One scheme in one case: what cases differ in, `scheme`, `actuator` (None for a bound), every
figure of merit by name, and `remarks`."""


def run_case(schemes: Sequence[str], actuators: Sequence[Actuator], case: Case) -> list[Row]:
    """Run the schemes on one case; InputError where one does not fit the plant or its data."""
    try:
        preparation = prepare(case.scenario, case.options, "study")
        return [{**case.columns, **row} for row, _ in run_schemes(preparation, schemes, actuators)]
    except InputError as error:
        raise error.within(label(case.columns)) from None


def run_schemes(
    preparation: Preparation, schemes: Sequence[str], actuators: Sequence[Actuator] = ()
) -> Iterator[tuple[Row, RunSeries]]:
    """Yield the row and the series of each scheme with each actuator, by default the scenario's.

    Where the network has faults, the agents themselves run; otherwise arrays give the same. Only
    the hierarchical schemes have a network.

    Grouping control has its best, median and worst reference group, by control-caused plus
    over-delivered energy: a group that trades one for the other does not win.
    """

    def missed_kwh(run: tuple[Figures, RunSeries]) -> float:
        return sum(run[0][f"{name}-energy"] or 0.0 for name in ("control-caused", "over-delivered"))

    plan, profile, remarks = preparation.plan, preparation.profile, remarks_of(preparation)
    actuators = actuators or (plan.control.actuator,)
    for name in schemes:
        for actuator in (None,) if name in BOUNDS else actuators:
            inverters = actuator or plan.control.actuator
            if plan.faults.rules and name in get_args(Scheme):
                series = [run_by_agents(plan, profile, cast(Scheme, name), inverters)]
            else:
                series = run_scheme(name, plan, profile, inverters)
            runs = sorted(((run_figures(one), one) for one in series), key=missed_kwh)
            named = {name: runs[0]}
            if len(runs) > 1:
                ranks = {"best": 0, "median": len(runs) // 2, "worst": -1}
                named = {f"{name} {rank}": runs[place] for rank, place in ranks.items()}
            for its_name, (figures, one) in named.items():
                title = f"{its_name}, {actuator}" if actuator and len(actuators) > 1 else its_name
                row = {"scheme": its_name, "actuator": actuator, **figures, "remarks": remarks}
                yield row, replace(one, label=title)


def remarks_of(preparation: Preparation) -> str:
    """Return what a reader must know about the data of a study."""
    perfect = "Faults act on paper and predictive; the other schemes have no network."
    more = [perfect] * bool(preparation.plan.faults.rules)
    return " ".join([*preparation.remarks, *more])
