"""The compiled loop does what the plain functions do, and the agents that call them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numba
import numpy as np
import pytest
from msgspec.structs import replace as replace_struct
from plans_by_hand import with_changes

from agents.settings import (
    Actuator,
    GridSettings,
    InverterSettings,
    OfferedCommitment,
    Scheme,
    StorageHelp,
    StorageSettings,
)
from recordings.read.series import RunSeries
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario
from scenarios.settings import with_settings
from sim_plant.profile import Profile
from studies.arrays.closed_loop import LoopResult, closed_loop, loop_inputs, run_loop
from studies.arrays.compiled import compiled
from studies.arrays.schemes import run_scheme
from studies.compare.by_agents import run_by_agents


@pytest.fixture(scope="module")
def oahu() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions(start="12:09", duration="200"), "loop")


@pytest.fixture(scope="module")
def valley() -> Preparation:
    return prepare(load_scenario("valley"), RunOptions(duration="60"), "loop")


@pytest.fixture(scope="module")
def fleet() -> Preparation:
    return prepare(load_scenario("fleet"), RunOptions(start="12:30", duration="200"), "loop")


RAMPS = GridSettings(
    ramp_up_kw_per_min=3000.0, ramp_down_kw_per_min=4000.0, meter_error_percent=0.5
)


def with_profile(preparation: Preparation, **changes: Any) -> Preparation:
    return replace(preparation, profile=replace(preparation.profile, **changes))


def with_plan(preparation: Preparation, **changes: object) -> Preparation:
    return replace(preparation, plan=with_changes(preparation.plan, **changes))


def assert_equal(preparation: Preparation, scheme: Scheme) -> None:
    """The loop is the same, bit for bit, compiled, in plain Python and through the agents."""
    plan, profile = preparation.plan, preparation.profile
    compiled = run_loop(plan, profile, scheme, plan.control.actuator)
    plain = closed_loop(*loop_inputs(plan, profile, scheme, plan.control.actuator))
    by_agents = run_by_agents(plan, profile, scheme, plan.control.actuator)
    for name in LoopResult._fields:
        by_plain = getattr(plain, name)
        np.testing.assert_array_equal(getattr(compiled, name), by_plain, err_msg=name)
        np.testing.assert_array_equal(getattr(by_agents, name), by_plain, err_msg=name)


def night(preparation: Preparation) -> Preparation:
    return with_profile(preparation, mpp_kw=np.zeros_like(preparation.profile.mpp_kw))


def absurd_dispatch(preparation: Preparation) -> Preparation:
    regulation_kw = np.zeros(preparation.profile.cycles)
    regulation_kw[20:40] = -1e5
    regulation_kw[60:80] = 1e5
    return with_profile(preparation, regulation_kw=regulation_kw)


def absurd_meters(preparation: Preparation) -> Preparation:
    error = np.zeros_like(preparation.profile.mpp_kw)
    error[10:14, 3] = 5.0
    error[50:53, 7] = -2.0
    error[70:100, 5] = 5.0  # For longer than it is counted on.
    return with_profile(preparation, meter_error=error)


def absurd_meters_behind_limits(preparation: Preparation) -> Preparation:
    return with_plan(absurd_meters(preparation), actuator="limit")


def available_power_stated(preparation: Preparation) -> Preparation:
    return with_plan(preparation, available_bias=0.02, actuator="limit")


def next_hour(preparation: Preparation) -> Preparation:
    options = RunOptions(start="12:58:20", duration="200")
    over = prepare(load_scenario("oahu"), options, "loop")
    orders = {hood.correlation for hood in over.plan.control.neighbourhoods[1].hours}
    assert len(orders) == 2
    # Neighbours matter to the power of each inverter where many are in need.
    return with_profile(over, mpp_kw=over.profile.mpp_kw * 0.6)


@pytest.mark.parametrize("actuator", get_args(Actuator))
@pytest.mark.parametrize("scheme", get_args(Scheme))
def test_loop_and_agents_give_the_same(
    oahu: Preparation, scheme: Scheme, actuator: Actuator
) -> None:
    error = 0.005 * np.random.default_rng(3).standard_normal(oahu.profile.mpp_kw.shape)
    assert_equal(with_plan(with_profile(oahu, meter_error=error), actuator=actuator), scheme)


@pytest.mark.parametrize("scheme", get_args(Scheme))
@pytest.mark.parametrize(
    "odd",
    [
        *(night, absurd_dispatch, absurd_meters, absurd_meters_behind_limits),
        *(available_power_stated, next_hour),
    ],
)
def test_loop_and_agents_give_the_same_at_night_with_absurd_inputs_and_into_the_next_hour(
    oahu: Preparation, scheme: Scheme, odd: Callable[[Preparation], Preparation]
) -> None:
    assert_equal(odd(oahu), scheme)


FOLLOWS: list[dict[str, object]] = [
    {"delay_s": 3.0},
    {"ramp_percent_per_s": 10.0},
    {"delay_s": 1.0, "ramp_percent_per_s": 20.0},
    {"settings": (InverterSettings(nodes="c1/*", delay_s=2.0, ramp_percent_per_s=3.0),)},
]


@pytest.mark.parametrize("follows", FOLLOWS, ids=str)
@pytest.mark.parametrize("actuator", get_args(Actuator))
@pytest.mark.parametrize("scheme", get_args(Scheme))
def test_loop_and_agents_give_the_same_where_inverters_follow_late_or_on_a_ramp(
    oahu: Preparation, scheme: Scheme, actuator: Actuator, follows: dict[str, object]
) -> None:
    cycles = oahu.profile.cycles
    regulation_kw = np.where(np.arange(cycles) // 40 % 2, 1500.0, -1500.0)
    stepped = with_profile(oahu, regulation_kw=regulation_kw)
    assert_equal(with_plan(stepped, actuator=actuator, **follows), scheme)


@pytest.mark.parametrize("actuator", get_args(Actuator))
def test_loop_and_agents_give_the_same_where_the_commitment_is_offered(actuator: Actuator) -> None:
    commitment = {"kind": "offered", "interval_s": 60, "lead_s": 10}
    scenario = with_settings(load_scenario("oahu"), [("commitment", commitment)])
    options = RunOptions(actuator=actuator, duration="20m")
    assert_equal(prepare(scenario, options, "loop"), "predictive")


STORAGES = (
    StorageSettings(name="battery", rating_kw=900.0, capacity_kwh=20.0, standing_loss_kw=40.0),
    StorageSettings(name="slow", rating_kw=500.0, capacity_kwh=9.0, state=0.3, delay_s=2.0),
    StorageSettings(
        name="small", cluster="c2", rating_kw=300.0, capacity_kwh=2.0, ramp_percent_per_s=20.0
    ),
)


@pytest.mark.parametrize("helps", ["last", "first"])
@pytest.mark.parametrize("scheme", get_args(Scheme))
@pytest.mark.parametrize("follows", FOLLOWS[:2], ids=str)
def test_loop_and_agents_give_the_same_with_storages(
    oahu: Preparation, scheme: Scheme, helps: StorageHelp, follows: dict[str, object]
) -> None:
    regulation_kw = np.where(np.arange(oahu.profile.cycles) // 40 % 2, 1500.0, -1500.0)
    stepped = with_profile(oahu, regulation_kw=regulation_kw)
    plan = with_plan(stepped, storages=STORAGES, storage=helps, **follows)
    assert_equal(plan, scheme)
    moved = run_loop(plan.plan, plan.profile, scheme, "limit").storage_power_kw
    assert (np.abs(moved).max(axis=0) > 20.0).all()


def test_loop_and_agents_give_the_same_with_storages_in_tiers_of_different_paces(
    valley: Preparation,
) -> None:
    cluster = valley.plan.tree.leaves[0].rpartition("/")[0]
    storages = tuple(
        StorageSettings(name="battery", cluster=where, rating_kw=900.0, capacity_kwh=20.0)
        for where in ("", cluster.partition("/")[0], cluster)
    )
    plan = with_plan(valley, storages=storages, period_cycles=(12, 4, 2))
    assert_equal(plan, "predictive")


@pytest.mark.parametrize("actuator", get_args(Actuator))
@pytest.mark.parametrize("scheme", get_args(Scheme))
def test_loop_and_agents_give_the_same_in_a_fleet(
    fleet: Preparation, scheme: Scheme, actuator: Actuator
) -> None:
    regulation_kw = np.where(np.arange(fleet.profile.cycles) // 40 % 2, 6000.0, -2500.0)
    stepped = with_plan(with_profile(fleet, regulation_kw=regulation_kw), actuator=actuator)
    plants = (replace_struct(stepped.plan.plants[0], grid=RAMPS), *stepped.plan.plants[1:])
    assert_equal(with_plan(stepped, plants=plants), scheme)


@pytest.mark.parametrize("actuator", get_args(Actuator))
def test_loop_and_agents_give_the_same_with_four_tiers_that_act_at_different_paces(
    valley: Preparation, actuator: Actuator
) -> None:
    assert_equal(with_plan(valley, actuator=actuator, period_cycles=(12, 4, 2)), "predictive")


def series_of(preparation: Preparation, name: str) -> RunSeries:
    plan = preparation.plan
    return run_scheme(name, plan, preparation.profile, plan.control.actuator)[0]


@pytest.mark.parametrize("name", ["uncontrolled", "predictive"])
def test_no_scheme_delivers_more_of_what_is_asked_than_the_physical_limit(
    oahu: Preparation, name: str
) -> None:
    limit = series_of(oahu, "physical-limit")
    np.testing.assert_allclose(
        limit.delivered_kw, np.minimum(limit.dispatch_kw, limit.available_kw), rtol=1e-12
    )
    other = series_of(oahu, name)
    assert (other.shortfall_kw >= limit.shortfall_kw - 1e-9).all()
    assert (other.power_kw <= other.mpp_kw + 1e-9).all()


@pytest.mark.parametrize("period_cycles", [(1, 1), (10, 1)])
def test_the_correction_makes_up_for_what_the_estimates_got_wrong(
    oahu: Preparation, period_cycles: tuple[int, ...]
) -> None:
    steady_kw = np.full((300, 17), 400.0)
    # Meters that read high make inverters seem to give what they are asked for.
    profile = replace(
        oahu.profile,
        mpp_kw=steady_kw,
        commitment_kw=np.full(300, 3000.0),
        regulation_kw=np.zeros(300),
        meter_error=np.full_like(steady_kw, 0.04),
    )
    plan = with_changes(oahu.plan, period_cycles=period_cycles)
    found = run_loop(plan, profile, "predictive", "fraction")
    assert found.power_kw[200:].sum(axis=1) == pytest.approx(3000.0, abs=1.0)
    without = run_loop(plan, profile, "paper", "fraction")
    assert without.power_kw[200:].sum(axis=1) == pytest.approx(3000.0 / 1.04, abs=1.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_inverters_that_go_dark_and_bright_at_random_miss_no_more_than_by_the_papers_rule(
    oahu: Preparation, seed: int
) -> None:
    """No trend foretells the power that returns, and a limit hides it."""
    rating_kw = oahu.profile.mpp_kw.max(axis=0)
    flips = np.random.default_rng(seed).random(oahu.profile.mpp_kw.shape) < 0.2
    mpp_kw = rating_kw * np.where(np.cumsum(flips, axis=0) % 2, 0.95, 0.2)
    desired_kw = np.full(oahu.profile.cycles, 0.5 * np.median(mpp_kw.sum(axis=1)))
    switched = with_profile(oahu, mpp_kw=mpp_kw, commitment_kw=desired_kw)
    missed_kw = {}
    for scheme in ("paper", "predictive"):
        run = run_scheme(scheme, switched.plan, switched.profile, "limit")[0]
        missed_kw[scheme] = np.clip(desired_kw - run.delivered_kw, 0.0, None).mean()
    assert missed_kw["predictive"] <= missed_kw["paper"]


def test_where_nothing_can_be_written_functions_are_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def twice(power_kw: float) -> float:
        return 2.0 * power_kw

    monkeypatch.setattr(numba.config, "CACHE_LOCATOR_CLASSES", "UserProvidedCacheLocator")
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/dev/null/nowhere")
    assert compiled(twice)(3.0) == 6.0


@pytest.mark.parametrize("actuator", get_args(Actuator))
def test_offers_count_on_what_a_storage_gives(oahu: Preparation, actuator: Actuator) -> None:
    """A shadow of ten seconds darkens each minute; a battery can give what it takes away."""
    cycles, rating_kw = 3600, oahu.plan.tree.rating_kw("")
    share = np.where(np.arange(cycles) % 60 < 10, 0.4, 0.9)
    parts = np.array([kw for _, kw in oahu.plan.inverters])
    zeros = np.zeros(cycles)
    profile = Profile(
        np.outer(share, parts), zeros, regulation_kw=zeros, clear_sky_kw=zeros + rating_kw
    )
    plan = with_changes(oahu.plan, cycles=cycles, offers=OfferedCommitment(interval_s=60, lead_s=5))
    battery = StorageSettings(name="battery", rating_kw=rating_kw / 4, capacity_kwh=rating_kw / 4)
    without, with_it = (
        run_loop(replace_struct(plan, storages=storages), profile, "predictive", actuator)
        for storages in ((), (battery,))
    )
    assert with_it.commitment_kw[-1] > 1.2 * without.commitment_kw[-1]
    given_kw = with_it.power_kw.sum(axis=1) + with_it.storage_power_kw.sum(axis=1)
    missed = np.maximum(with_it.commitment_kw - given_kw, 0.0)[1800:].reshape(-1, 60).sum(axis=1)
    promised = with_it.commitment_kw[1800:].reshape(-1, 60).sum(axis=1)
    assert np.mean(missed <= 0.01 * promised) >= 0.9
