"""A direct controller sends numbers that can be used, whatever its inverter states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_runs import run_in_memory
from plans_by_hand import plan_of
from plants_by_hand import AtWork, at, dispatch, head, setpoint, telemetry

from agents.agent import Turn
from agents.settings import Actuator, Scheme
from agents.team import controller
from bus_schemas.bounds import bounds_of, is_within
from bus_schemas.messages import Message, Telemetry
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, RESIDUAL, TELEMETRY
from bus_schemas.tree import PLANT, ROOT
from sim_plant.profile import Profile

NODE = "c1/a"
RATING_KW = 100.0
ANY = st.one_of(st.floats(), st.floats(-1.0, 120.0), st.sampled_from([0.0, 1.0, 100.0]))


def is_sound(message: Message) -> bool:
    return is_within(message, bounds_of(type(message), RATING_KW))


@given(
    scheme=st.sampled_from(["paper", "predictive"]),
    actuator=st.sampled_from(["fraction", "limit"]),
    stated=st.lists(st.tuples(ANY, ANY, ANY, st.none() | ANY), min_size=1, max_size=6),
    wanted_kw=st.floats(0.0, RATING_KW),
)
@settings(max_examples=150)
def test_whatever_telemetry_says_estimate_and_command_are_within_their_bounds(
    scheme: Scheme,
    actuator: Actuator,
    stated: list[tuple[float, float, float, float | None]],
    wanted_kw: float,
) -> None:
    plan = plan_of({NODE: RATING_KW}, cycles=len(stated), scheme=scheme, actuator=actuator)
    work = AtWork(plan, NODE)
    for cycle, (power_kw, alpha, limit_kw, available_kw) in enumerate(stated):
        stated_now = Telemetry(
            *head(cycle, PLANT),
            power_kw=power_kw,
            alpha=alpha,
            limit_kw=limit_kw,
            available_kw=available_kw,
        )
        sent = work.hear((TELEMETRY.of(NODE), stated_now), dispatch(cycle, 50.0, RATING_KW))
        assert is_sound(at(sent, IMPP.of(NODE)))
        assert is_sound(at(sent, RESIDUAL.of(NODE)))
        command = at(work.hear(setpoint(NODE, cycle, wanted_kw)), COMMAND.of(NODE))
        assert is_sound(command)
        assert command.alpha >= plan.control.alpha_floor


def test_where_an_inverter_states_its_available_power_nothing_is_hidden_behind_a_limit() -> None:
    """Each could give 90 kW, and 30 kW are wanted of it."""
    profile = Profile(np.full((30, 2), 90.0), np.full(30, 60.0))
    furthest_kw = {}
    for bias in (None, 0.0):
        plan = plan_of(
            {"a": 100.0, "b": 100.0},
            cycles=30,
            scheme="predictive",
            actuator="limit",
            available_bias=bias,
        )
        _, heard = run_in_memory(plan, profile)
        impp_kw = [heard.of(IMPP.of("a"))[cycle].power_kw for cycle in range(5, 30)]
        furthest_kw[bias] = max(abs(kw - 90.0) for kw in impp_kw)
        assert heard.of(PRODUCTION.of(ROOT))[29].delivered_kw == pytest.approx(60.0, abs=1.0)
    assert furthest_kw[0.0] < 1e-6 < furthest_kw[None]


def test_after_cycles_that_it_skipped_a_change_is_no_trend() -> None:
    """Its maximum falls from 90 to 50 kW while it stands still, and stays there."""
    agent = controller(plan_of({NODE: RATING_KW}, cycles=100, scheme="predictive"), NODE)
    state = agent.initial_state()
    readings_kw = {**dict.fromkeys(range(10), 90.0), 30: 50.0}
    for cycle, power_kw in readings_kw.items():
        _, asked = dispatch(cycle, 50.0, RATING_KW)
        inputs = {
            TELEMETRY.of(NODE): telemetry(NODE, cycle, power_kw)[1],
            DISPATCH.of(ROOT): asked,
        }
        turn = Turn("estimate", cycle, 0, (*head(cycle, NODE), 0, 0, 0, 0), inputs)
        state, sent = agent.step(state, turn)
    assert at(dict(sent), IMPP.of(NODE)).power_kw == pytest.approx(50.0, abs=1.0)
