"""A study gives the same wherever its cases run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import RunOptions
from launch_scripts.scenarios.scenario import load_scenario
from studies.arrays.schemes import ReferenceGroups
from studies.compare.cases import Case, cases
from studies.compare.study import CaseResult, Comparison, SchemeResult, run_case, run_cases

COMPARISON = Comparison(("paper", "predictive", "grouping"), ReferenceGroups((1, 5), 3))


@pytest.fixture(scope="module")
def study() -> list[Case]:
    return cases(load_scenario("oahu"), RunOptions(duration="120"), seeds=(1, 2, 3))


@pytest.fixture(scope="module")
def alone(study: list[Case]) -> list[tuple[SchemeResult, ...]]:
    return [run_case(case, COMPARISON).schemes for case in study]


def in_order(found: Iterator[tuple[int, CaseResult]]) -> list[tuple[SchemeResult, ...]]:
    return [result.schemes for _, result in sorted(found, key=lambda pair: pair[0])]


def test_grouping_is_told_by_its_best_median_and_worst_reference_group(
    alone: list[tuple[SchemeResult, ...]],
) -> None:
    names = ["paper", "predictive", "grouping best", "grouping median", "grouping worst"]
    for schemes in alone:
        assert [entry.scheme for entry in schemes] == names
        shortfalls = [entry.metrics.commitment.control_caused_kwh for entry in schemes[2:]]
        assert shortfalls == sorted(shortfalls)


def test_one_process_after_the_other_gives_the_same(
    study: list[Case], alone: list[tuple[SchemeResult, ...]]
) -> None:
    assert in_order(run_cases(study, COMPARISON)) == alone


def test_several_processes_give_the_same(
    study: list[Case], alone: list[tuple[SchemeResult, ...]]
) -> None:
    assert in_order(run_cases(study, COMPARISON, workers=2)) == alone


@pytest.mark.processes
def test_a_dask_cluster_gives_the_same(
    study: list[Case], alone: list[tuple[SchemeResult, ...]]
) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        assert in_order(run_cases(study, COMPARISON, scheduler=address)) == alone


def test_a_scheduler_that_is_no_address_is_refused(study: list[Case]) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    with pytest.raises(InputError, match="--scheduler nowhere: cannot be reached"):
        list(run_cases(study, COMPARISON, scheduler="nowhere"))


def test_through_the_agents_it_is_the_same(study: list[Case]) -> None:
    arrays = run_case(study[0], Comparison(("paper",)))
    agents = run_case(study[0], Comparison(("paper",), through_agents=True))
    for by_arrays, by_agents in zip(arrays.schemes, agents.schemes, strict=True):
        found = by_agents.metrics.commitment.unsatisfied_kwh
        assert found == pytest.approx(by_arrays.metrics.commitment.unsatisfied_kwh, abs=1e-9)


def test_a_case_that_does_not_fit_is_named() -> None:
    too_large = Comparison(("grouping",), ReferenceGroups((17,)))
    (case,) = cases(load_scenario("oahu"), RunOptions(duration="10"), seeds=(4,))
    with pytest.raises(InputError) as caught:
        run_case(case, too_large)
    assert str(caught.value) == ("seed=4: --reference 17: accepted are groups of 1 to 16 inverters")
