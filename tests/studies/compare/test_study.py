"""A comparison runs its schemes on each case."""

from __future__ import annotations

import pytest

from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import RunOptions
from launch_scripts.scenarios.scenario import load_scenario
from studies.arrays.schemes import ReferenceGroups
from studies.compare.cases import Case, cases
from studies.compare.results import cases_tables
from studies.compare.study import CaseResult, Comparison, run_case

COMPARISON = Comparison(("paper", "predictive", "grouping"), ReferenceGroups((1, 5), 3))
SCHEMES = ["paper", "predictive", "grouping best", "grouping median", "grouping worst"]


@pytest.fixture(scope="module")
def study() -> list[Case]:
    return cases(load_scenario("oahu"), RunOptions(duration="120"), seeds=(1, 2, 3))


@pytest.fixture(scope="module")
def alone(study: list[Case]) -> list[CaseResult]:
    return [run_case(COMPARISON, case) for case in study]


def test_grouping_has_its_best_median_and_worst_reference_group(alone: list[CaseResult]) -> None:
    for result in alone:
        assert [entry.scheme for entry in result.schemes] == SCHEMES
        energies = [entry.metrics.commitment for entry in result.schemes[2:]]
        missed = [one.control_caused_kwh + one.over_delivered_kwh for one in energies]
        assert missed == sorted(missed)


def test_every_scheme_but_the_bounds_is_run_with_each_actuator(study: list[Case]) -> None:
    both = Comparison(("uncontrolled", "uniform-cap", "paper"), actuators=("fraction", "limit"))
    found = {(one.scheme, one.actuator): one.metrics for one in run_case(both, study[0]).schemes}
    (own,) = run_case(Comparison(("paper",)), study[0]).schemes
    assert own.metrics == found["paper", "fraction"], "oahu's own actuator"
    # A limit holds whatever the sky does, a fraction of an old maximum does not.
    assert found["uniform-cap", "limit"].commitment.over_delivered_kwh == pytest.approx(0.0)
    assert found["uniform-cap", "fraction"].commitment.over_delivered_kwh > 1e-3


def test_a_case_that_does_not_fit_is_named() -> None:
    too_large = Comparison(("grouping",), ReferenceGroups((17,)))
    (case,) = cases(load_scenario("oahu"), RunOptions(duration="10"), seeds=(4,))
    with pytest.raises(InputError) as caught:
        run_case(too_large, case)
    assert str(caught.value).startswith("seed=4: --reference")


def test_very_many_cases_are_summarised_alone(alone: list[CaseResult]) -> None:
    (table,) = cases_tables(["rmse"], alone * 20)
    assert [row[0] for row in table.rows] == SCHEMES
