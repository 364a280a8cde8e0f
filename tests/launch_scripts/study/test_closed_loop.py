"""The compiled loop does what the agents do between them."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import msgspec
import numpy as np
import pytest

from agents.plan import Actuator, Scheme
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.study.closed_loop import TOLD, Estimator, run_loop
from launch_scripts.study.schemes import ReferenceGroups, run_scheme
from launch_scripts.study.study import run_agents
from recordings.series import RunSeries

ARRAYS = ("power_kw", "impp_kw", "residual_kw", "alpha")


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions(start="12:09", duration="200"), "loop")


@pytest.fixture(scope="module")
def valley() -> Preparation:
    return prepare(load_scenario("valley"), RunOptions(duration="60"), "loop")


def with_meter_error(preparation: Preparation, share: float) -> Preparation:
    error = share * np.random.default_rng(3).standard_normal(preparation.profile.mpp_kw.shape)
    return replace(preparation, profile=replace(preparation.profile, meter_error=error))


def with_plan(preparation: Preparation, **changes: object) -> Preparation:
    return replace(preparation, plan=msgspec.structs.replace(preparation.plan, **changes))


def assert_equal(preparation: Preparation, scheme: Scheme) -> None:
    plan, profile = preparation.plan, preparation.profile
    by_agents = run_agents(scheme, preparation)
    (by_arrays,) = run_scheme(scheme, plan, profile, plan.actuator, ReferenceGroups())
    for name in ARRAYS:
        np.testing.assert_allclose(
            getattr(by_arrays, name), getattr(by_agents, name), rtol=0, atol=1e-9, err_msg=name
        )
    np.testing.assert_array_equal(by_arrays.desired_kw, by_agents.desired_kw)
    np.testing.assert_array_equal(by_arrays.mpp_kw, by_agents.mpp_kw)


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("actuator", get_args(Actuator))
@pytest.mark.parametrize("scheme", get_args(Scheme))
def test_agents_and_arrays_give_the_same(
    oahu: Preparation, scheme: Scheme, actuator: Actuator, noise: float
) -> None:
    assert_equal(with_plan(with_meter_error(oahu, noise), actuator=actuator), scheme)


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_so_they_do_over_a_whole_hour_behind_limits(share: float) -> None:
    # Where an inverter is held or let free by a hair's breadth, a rounding error would show.
    hour = prepare(load_scenario("oahu"), RunOptions(actuator="limit"), "loop")
    assert_equal(with_meter_error(hour, share), "predictive")


def test_so_they_do_where_an_hour_ends_and_the_neighbours_change() -> None:
    options = RunOptions(start="12:58:20", duration="200")
    over = prepare(load_scenario("oahu"), options, "loop")
    orders = {hood.correlation for hood in over.plan.neighbourhoods[1].hours}
    assert len(orders) == 2
    # Neighbours matter to the power of each inverter where many are in need.
    dim = replace(over, profile=replace(over.profile, mpp_kw=over.profile.mpp_kw * 0.6))
    assert_equal(dim, "predictive")


@pytest.mark.parametrize("actuator", get_args(Actuator))
def test_so_they_do_with_four_tiers_that_act_at_different_paces(
    valley: Preparation, actuator: Actuator
) -> None:
    changed = with_plan(valley, actuator=actuator, period_cycles=(12, 4, 2))
    assert_equal(changed, "predictive")


def test_so_they_do_where_the_dispatch_makes_no_sense(oahu: Preparation) -> None:
    regulation_kw = np.zeros(oahu.profile.cycles)
    regulation_kw[20:40] = -1e5
    regulation_kw[60:80] = 1e5
    changed = replace(oahu, profile=replace(oahu.profile, regulation_kw=regulation_kw))
    assert_equal(changed, "predictive")


def test_so_they_do_where_a_meter_reads_absurd_powers(oahu: Preparation) -> None:
    error = np.zeros_like(oahu.profile.mpp_kw)
    error[10:14, 3] = 5.0
    error[50:53, 7] = -2.0
    assert_equal(replace(oahu, profile=replace(oahu.profile, meter_error=error)), "predictive")


def test_through_the_night_nothing_is_missed_or_divided_by_zero(oahu: Preparation) -> None:
    dark = replace(oahu.profile, mpp_kw=np.zeros_like(oahu.profile.mpp_kw))
    assert_equal(replace(oahu, profile=dark), "predictive")


def test_told_the_maxima_a_limit_hides_nothing(oahu: Preparation) -> None:
    plan, profile = oahu.plan, oahu.profile
    told = run_loop(plan, profile, Estimator(TOLD), "limit")
    np.testing.assert_array_equal(told.impp_kw[1:], profile.mpp_kw[:-1])


def series_of(preparation: Preparation, name: str) -> RunSeries:
    plan = preparation.plan
    return run_scheme(name, plan, preparation.profile, plan.actuator, ReferenceGroups())[0]


@pytest.mark.parametrize("name", ["uncontrolled", "uniform-cap", "paper", "predictive"])
def test_no_scheme_delivers_more_of_what_is_asked_than_the_physical_limit(
    oahu: Preparation, name: str
) -> None:
    limit = series_of(oahu, "physical-limit")
    np.testing.assert_allclose(
        limit.delivered_kw, np.minimum(limit.desired_kw, limit.possible_kw), rtol=1e-12
    )
    other = series_of(oahu, name)
    assert (other.support_kw >= limit.support_kw - 1e-9).all()
    assert (other.power_kw <= other.mpp_kw + 1e-9).all()
