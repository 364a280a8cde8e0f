"""The same day under clusters chosen in different ways."""

from __future__ import annotations

import dataclasses
from functools import partial

import msgspec
import numpy as np
import pandas as pd
import pytest

from agents.control.clusters import search_clusters, within_cluster_correlation
from agents.control.neighbours import help_order
from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import ControlTable, ScenarioFile
from launch_scripts.scenarios.scenario import load_scenario as load
from sim_plant.profile import Profile
from studies.clusters.study import (
    Arrange,
    by_first_part,
    by_scenario,
    in_other_orders,
    past_of,
    worth_of,
)
from studies.compare.cases import cases, parse_setting

OPTIONS = RunOptions(scheme="paper")
WAYS = ("correlation", "geographic", "random", "most-alike")


@pytest.fixture(scope="module")
def scenario() -> ScenarioFile:
    """The hour on Oahu in steps of 10 s."""
    return cases(load("oahu"), RunOptions(), [parse_setting("time.cycle_s=10")])[0].scenario


@pytest.fixture(scope="module")
def oahu(scenario: ScenarioFile) -> Preparation:
    return prepare(scenario, OPTIONS, "clusters")


@pytest.fixture(scope="module")
def arrange(scenario: ScenarioFile) -> Arrange:
    return partial(by_scenario, scenario, OPTIONS)


@pytest.fixture(scope="module")
def past(scenario: ScenarioFile, arrange: Arrange) -> pd.DataFrame:
    return past_of(arrange, scenario.scenario.control, 17)


def chosen(scenario: ScenarioFile, **changes: object) -> ControlTable:
    return msgspec.structs.replace(scenario.scenario.control, **changes)


def names(preparation: Preparation) -> list[str]:
    return [leaf.rpartition("/")[2] for leaf in preparation.plan.tree.leaves]


def members(preparation: Preparation) -> set[frozenset[str]]:
    found: dict[str, set[str]] = {}
    for leaf in preparation.plan.tree.leaves:
        cluster, _, name = leaf.rpartition("/")
        found.setdefault(cluster, set()).add(name)
    return {frozenset(cluster) for cluster in found.values()}


def test_the_virtual_clusters_are_the_best_that_the_search_finds_in_the_past(
    scenario: ScenarioFile, arrange: Arrange, past: pd.DataFrame
) -> None:
    search = search_clusters(past.to_numpy(), (6, 6, 5))
    assert members(arrange(chosen(scenario, clusters="correlation"))) == {
        frozenset(past.index[place] for place in cluster) for cluster in search.clusters
    }


def test_of_all_ways_virtual_clusters_are_least_alike_and_the_last_are_most(
    scenario: ScenarioFile, arrange: Arrange, past: pd.DataFrame
) -> None:
    worth = {way: worth_of(arrange(chosen(scenario, clusters=way)), past, (1,)) for way in WAYS}
    alike = [worth[way].past_correlation for way in ("correlation", "random", "most-alike")]
    assert alike == sorted(alike)
    assert alike[0] < worth["geographic"].past_correlation <= alike[2]
    for found in worth.values():
        assert [len(cluster) for cluster in found.members] == [6, 6, 5]
        assert sorted(name for cluster in found.members for name in cluster) == sorted(past.index)
    # However clusters are chosen, the same inverters are in need in the same cycles.
    assert len({found.help.plant.needy for found in worth.values()}) == 1


def test_correlation_in_the_run_is_that_of_its_own_power(
    oahu: Preparation, past: pd.DataFrame
) -> None:
    found = worth_of(oahu, past, (1,))
    # The run is one hour long, from twelve to one.
    power = np.asarray(np.corrcoef(oahu.profile.mpp_kw.T))
    expected = within_cluster_correlation(power, [range(6), range(6, 12), range(12, 17)])
    assert found.run_correlation == pytest.approx(expected, abs=1e-12)


def test_a_dark_turn_of_the_central_controller_costs_until_its_next(
    oahu: Preparation, past: pd.DataFrame
) -> None:
    # 17 inverters of 400 kW, but for 200 kW in cycle 9; the plant has promised 5000 kW.
    mpp_kw = np.full((30, 17), 400.0)
    mpp_kw[9] = 200.0
    plan = msgspec.structs.replace(oahu.plan, cycles=30)
    changed = dataclasses.replace(oahu, plan=plan, profile=Profile(mpp_kw, np.full(30, 5000.0)))
    always, tenth = worth_of(changed, past, (1, 10)).shortfalls
    # In cycle 9 the plant gives 5000 x 3400 / 6800 of the 3400 kW that it has: 900 kW less.
    percent_of_a_cycle = 100.0 / 30
    unavoidable = percent_of_a_cycle * 1600 / 5000
    unseen = percent_of_a_cycle * 900 / 5000
    assert always.unavoidable_percent == tenth.unavoidable_percent == pytest.approx(unavoidable)
    assert always.control_caused_percent == pytest.approx(unseen)
    assert always.begun_lacking_percent == pytest.approx(0.0, abs=1e-9)
    # In cycle 10 the central controller learns of 3400 kW, and takes its turn: clusters are asked
    # for that much up to cycle 19, though they have 6800 kW again.
    held = percent_of_a_cycle * 9 * 1600 / 5000
    assert tenth.control_caused_percent == pytest.approx(unseen + held)
    assert tenth.begun_lacking_percent == pytest.approx(held)


def test_in_the_last_order_of_help_siblings_are_asked_the_other_way_round(
    oahu: Preparation,
) -> None:
    orders = in_other_orders(oahu)
    assert orders["as listed"].plan.neighbourhoods == ()
    for node in oahu.plan.tree.parents:
        (before,) = orders["least alike first"].plan.neighbourhoods_of(node)
        (after,) = orders["most alike first"].plan.neighbourhoods_of(node)
        forwards, backwards = help_order(before.correlation), help_order(after.correlation)
        assert [siblings[::-1] for siblings in backwards] == list(forwards)


def test_what_is_left_begins_where_learning_ends(oahu: Preparation, scenario: ScenarioFile) -> None:
    for way in WAYS:
        found = by_first_part(oahu, 1200.0)(chosen(scenario, clusters=way))
        assert found.plan.cycles == found.profile.cycles == 240
        assert found.plan.start_time_ns == oahu.plan.sim_time_ns(120)
        columns = [names(oahu).index(name) for name in names(found)]
        np.testing.assert_array_equal(found.profile.mpp_kw, oahu.profile.mpp_kw[120:, columns])
        np.testing.assert_array_equal(found.profile.commitment_kw, oahu.profile.commitment_kw[120:])


def test_clusters_are_chosen_from_the_first_part_alone(
    oahu: Preparation, scenario: ScenarioFile
) -> None:
    def clusters(changed: slice) -> set[frozenset[str]]:
        mpp_kw = oahu.profile.mpp_kw.copy()
        mpp_kw[changed] = mpp_kw[changed, ::-1]
        profile = dataclasses.replace(oahu.profile, mpp_kw=mpp_kw)
        other = dataclasses.replace(oahu, profile=profile)
        return members(by_first_part(other, 1200.0)(chosen(scenario, clusters="correlation")))

    assert clusters(slice(0)) == clusters(slice(120, None)) != clusters(slice(120))


@pytest.mark.parametrize("learn_s", [10.0, 15.0, 3600.0])
def test_a_first_part_that_leaves_nothing_to_learn_from_or_to_run_is_refused(
    oahu: Preparation, learn_s: float
) -> None:
    with pytest.raises(InputError, match="--learn"):
        by_first_part(oahu, learn_s)
