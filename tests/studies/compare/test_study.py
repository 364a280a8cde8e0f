"""A comparison runs its schemes on each case."""

from __future__ import annotations

import pytest

from bus_schemas.errors import InputError
from scenarios.preparation import RunOptions
from scenarios.scenario import load_scenario
from scenarios.settings import Setting
from studies.arrays.schemes import ReferenceGroups
from studies.compare.cases import Case, cases
from studies.compare.results import cases_tables
from studies.compare.study import CaseResult, SchemeChoice, run_case

CHOICE = SchemeChoice(("paper", "predictive", "grouping"), ReferenceGroups((1, 5), 3))
SCHEMES = ["paper", "predictive", "grouping best", "grouping median", "grouping worst"]


@pytest.fixture(scope="module")
def study() -> list[Case]:
    return cases(load_scenario("oahu"), RunOptions(duration="120"), seeds=(1, 2, 3))


@pytest.fixture(scope="module")
def alone(study: list[Case]) -> list[CaseResult]:
    return [run_case(CHOICE, case) for case in study]


def test_grouping_has_its_best_median_and_worst_reference_group(alone: list[CaseResult]) -> None:
    for result in alone:
        assert [entry.scheme for entry in result.schemes] == SCHEMES
        energies = [entry.metrics.commitment for entry in result.schemes[2:]]
        missed = [one.control_caused_kwh + one.over_delivered_kwh for one in energies]
        assert missed == sorted(missed)


def test_every_scheme_but_the_bounds_is_run_with_each_actuator(study: list[Case]) -> None:
    both = SchemeChoice(("uncontrolled", "uniform-cap", "paper"), actuators=("fraction", "limit"))
    found = {(one.scheme, one.actuator): one.metrics for one in run_case(both, study[0]).schemes}
    (own,) = run_case(SchemeChoice(("paper",)), study[0]).schemes
    assert own.metrics == found["paper", "fraction"], "oahu's own actuator"
    # A limit holds whatever the sky does, a fraction of an old maximum does not.
    assert found["uniform-cap", "limit"].commitment.over_delivered_kwh == pytest.approx(0.0)
    assert found["uniform-cap", "fraction"].commitment.over_delivered_kwh > 1e-3


def test_a_case_that_does_not_fit_is_named() -> None:
    too_large = SchemeChoice(("grouping",), ReferenceGroups((17,)))
    (case,) = cases(load_scenario("oahu"), RunOptions(duration="10"), seeds=(4,))
    with pytest.raises(InputError) as caught:
        run_case(too_large, case)
    assert str(caught.value).startswith("seed=4: --reference")


def test_faults_act_on_the_agents_and_are_counted() -> None:
    faults = ("none", "loss=5%", "loss=20%", "delay=2s", "kill=c1/inv01,at=30s")
    short = RunOptions(start="12:00", duration="90")
    # With this share no shortfall is unavoidable: what the network spoils stands out.
    share = [Setting("commitment.share", (0.4,))]
    choice = SchemeChoice(("paper", "uniform-cap"))
    listed = cases(load_scenario("oahu"), short, share, faults)
    results = [run_case(choice, case) for case in listed]
    paper, uniform_cap = zip(*(result.schemes for result in results), strict=True)
    missed = [one.metrics.missed_inputs or 0 for one in paper]
    assert missed[0] == 0 < missed[4] < missed[1] < missed[2] < missed[3]
    caused_kwh = [one.metrics.commitment.control_caused_kwh for one in paper]
    assert caused_kwh[0] < min(caused_kwh[1:4])
    assert len({one.metrics.commitment for one in uniform_cap}) == 1, "it has no network"
    assert [any("Faults act" in line for line in one.remarks) for one in results] == [
        False, True, True, True, True,
    ]  # fmt: skip


def test_an_inverter_that_hears_nothing_for_its_revert_time_has_reverted() -> None:
    (case,) = cases(
        load_scenario("oahu"),
        RunOptions(duration="60"),
        [Setting("plant.revert", ({"after_s": 10},))],
        ["partition=c1/inv01|plant,at=20s..40s"],
    )
    (entry,) = run_case(SchemeChoice(("paper",)), case).schemes
    # Its last command is that of cycle 19; commands come again in cycle 40.
    assert entry.metrics.reverted_percent == pytest.approx(100.0 * 11 / (60 * 17))


def test_very_many_cases_are_summarised_alone(alone: list[CaseResult]) -> None:
    (table,) = cases_tables(["rmse"], alone * 20)
    assert [row[0] for row in table.rows] == SCHEMES
