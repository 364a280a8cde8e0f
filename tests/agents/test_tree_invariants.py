"""What holds at every node of any control tree, in every cycle, under any sky and any operator."""

from __future__ import annotations

from collections.abc import Iterable
from math import fsum, inf, isfinite, nan, prod
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_runs import Sent, run_in_memory
from plans_by_hand import plan_of

from agents.plan import RunPlan
from bus_schemas.signals import HELP, IMPP, RESIDUAL, SETPOINT
from bus_schemas.tree import ROOT, ControlTree
from sim_plant.profile import Profile

TOLERANCE_KW = 1e-6


class Weather(NamedTuple):
    """A plant, and what sun and operator do to it in each cycle."""

    plan: RunPlan
    mpp_kw: list[list[float]]
    dispatch_kw: list[float]

    def hear(self) -> Sent:
        profile = Profile(np.array(self.mpp_kw), np.array(self.dispatch_kw))
        return run_in_memory(self.plan, profile)[1]


@st.composite
def ratings(draw: st.DrawFn) -> dict[str, float]:
    """Inverters at random places below 0 to 4 tiers of clusters, not all at the same depth."""
    deepest = draw(st.integers(0, 4))
    places = st.lists(st.integers(1, 3), max_size=deepest)
    rating = st.one_of(st.just(470.0), st.floats(0.5, 5000.0))
    inverters = draw(st.lists(st.tuples(places, rating), min_size=1, max_size=30))
    return {
        "/".join([*(f"c{place}" for place in clusters), f"inv{number:02}"]): rating_kw
        for number, (clusters, rating_kw) in enumerate(inverters, start=1)
    }


@st.composite
def periods(draw: st.DrawFn, tree: ControlTree) -> tuple[int, ...]:
    """Each tier acts as often as the one below it, or half as often."""
    factors = draw(st.lists(st.integers(1, 2), min_size=tree.height, max_size=tree.height))
    return tuple(prod(factors[tier:]) for tier in range(tree.height))


@st.composite
def weathers(draw: st.DrawFn) -> Weather:
    ratings_kw = draw(ratings())
    tree = ControlTree(tuple(ratings_kw.items()))
    cycles = draw(st.integers(1, 5))
    plant_kw = tree.rating_kw(ROOT)
    light = st.one_of(st.sampled_from([0.0, 1.0, 1.01, nan]), st.floats(0.0, 1.0))
    usable = st.floats(0.0, 1.0).map(lambda share: share * plant_kw)
    wish = st.one_of(usable, st.sampled_from([0.0, plant_kw, -1.0, nan, inf, -inf, 1e12]))
    count = len(ratings_kw)
    lights = draw(
        st.lists(st.lists(light, min_size=count, max_size=count), min_size=cycles, max_size=cycles)
    )
    return Weather(
        plan_of(ratings_kw, cycles=cycles, period_cycles=draw(periods(tree))),
        [
            [share * rating for share, rating in zip(row, ratings_kw.values(), strict=True)]
            for row in lights
        ],
        [draw(usable), *draw(st.lists(wish, min_size=cycles - 1, max_size=cycles - 1))],
    )


def usable_dispatches_kw(weather: Weather) -> list[float]:
    """In each cycle the last dispatch that can be used."""
    rating_kw, last_kw = weather.plan.tree.rating_kw(ROOT), 0.0
    usable_kw: list[float] = []
    for wished_kw in weather.dispatch_kw:
        last_kw = min(max(wished_kw, 0.0), rating_kw) if isfinite(wished_kw) else last_kw
        usable_kw.append(last_kw)
    return usable_kw


@given(weathers())
@settings(max_examples=30)
def test_whenever_a_parent_acts_its_children_meet_its_newest_target_or_give_all_there_is(
    weather: Weather,
) -> None:
    heard, plan = weather.hear(), weather.plan
    target_kw = dict.fromkeys(plan.tree.parents, 0.0)
    for cycle, dispatch_kw in enumerate(usable_dispatches_kw(weather)):
        target_kw[ROOT] = dispatch_kw
        for node in plan.tree.parents:
            if node != ROOT and (own := heard.of(SETPOINT.of(node)).get(cycle)):
                target_kw[node] = own.power_kw
            children = plan.tree.children(node)
            if not plan.control.periods.acts(node, cycle):
                assert not any(heard.of(SETPOINT.of(child)).get(cycle) for child in children)
                continue
            setpoints = [heard.of(SETPOINT.of(child))[cycle] for child in children]
            set_kw = [setpoint.power_kw for setpoint in setpoints]
            impp_kw = [heard.of(IMPP.of(child))[cycle].power_kw for child in children]
            all_kw = fsum(impp_kw)
            expected_kw = min(max(target_kw[node], plan.control.alpha_floor * all_kw), all_kw)
            assert fsum(set_kw) == pytest.approx(expected_kw, rel=0.0, abs=TOLERANCE_KW)
            for setpoint_kw, most_kw in zip(set_kw, impp_kw, strict=True):
                assert plan.control.alpha_floor * most_kw - TOLERANCE_KW <= setpoint_kw <= most_kw
            lines = [line for setpoint in setpoints for line in setpoint.help_given]
            for child, setpoint, most_kw in zip(children, setpoints, impp_kw, strict=True):
                above_kw = max(setpoint.power_kw - setpoint.share_kw, 0.0)
                assert approx_kw([above_kw]) == fsum(one.power_kw for one in setpoint.help_given)
                got_kw = fsum(line.power_kw for line in lines if line.needy == child)
                lacks_kw = max(setpoint.share_kw - most_kw, 0.0)
                assert got_kw <= lacks_kw + TOLERANCE_KW
                if target_kw[node] <= all_kw:
                    assert got_kw == approx_kw([lacks_kw])


@given(weathers())
@settings(max_examples=25)
def test_reports_add_up_and_what_is_missing_is_called_for_up_to_the_root(weather: Weather) -> None:
    heard, tree = weather.hear(), weather.plan.tree
    for cycle, dispatch_kw in enumerate(usable_dispatches_kw(weather)):
        for node in tree.nodes:
            own, residual = heard.of(IMPP.of(node))[cycle], heard.of(RESIDUAL.of(node))[cycle]
            call = heard.of(HELP.of(node)).get(cycle)
            lacks = residual.power_kw < 0.0
            assert (call.missing_kw if call else None) == (-residual.power_kw if lacks else None)
            if children := tree.children(node):
                impps = [heard.of(IMPP.of(child))[cycle] for child in children]
                residuals = [heard.of(RESIDUAL.of(child))[cycle] for child in children]
                assert own.power_kw == approx_kw(impp.power_kw for impp in impps)
                assert own.stale_cycles == max(impp.stale_cycles for impp in impps)
                assert residual.power_kw == approx_kw(found.power_kw for found in residuals)
        missing_kw = max(dispatch_kw - heard.of(IMPP.of(ROOT))[cycle].power_kw, 0.0)
        call = heard.of(HELP.of(ROOT)).get(cycle)
        assert (call.missing_kw if call else 0.0) == approx_kw([missing_kw])


def approx_kw(powers_kw: Iterable[float]) -> object:
    """A sum, but for rounding errors."""
    return pytest.approx(fsum(powers_kw), rel=0.0, abs=TOLERANCE_KW)
