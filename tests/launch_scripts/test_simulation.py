"""A whole plant in memory: worked out by hand, and the same in every run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from memory_runs import Sent, run_in_memory
from plans_by_hand import CYCLE_NS, plan_of

from agents.plan_parts import Neighbourhood, NodeNeighbourhoods
from bus_schemas.errors import FailureError
from bus_schemas.signals import (
    DISPATCH,
    PRODUCTION,
    SETPOINT,
    Port,
)
from bus_schemas.tree import ROOT
from launch_scripts.simulation import MemoryRun
from sim_plant.profile import Profile

PLAN = plan_of({"a": 100.0, "b": 100.0}, cycles=3)
"""Two inverters of 100 kW below the central controller, three cycles."""

# A cloud covers a in cycle 1, and both in cycle 2.
PROFILE = Profile(
    mpp_kw=np.array([[80.0, 60.0], [20.0, 64.0], [16.0, 40.0]]),
    commitment_kw=np.array([80.0, 80.0, 120.0]),
)


def power_kw(sent: Sent, cycle: int, *ports: Port[Any]) -> list[float]:
    """What several ports say of power in a cycle."""
    return [sent.of(port)[cycle].power_kw for port in ports]


@pytest.fixture(scope="module")
def sent() -> Sent:
    return run_in_memory(PLAN, PROFILE)[1]


def test_each_hour_has_its_order_of_help_and_the_first_one_holds_before_it() -> None:
    def hour(from_cycle: int, a_and_b: float, a_and_c: float) -> Neighbourhood:
        rows = (1.0, a_and_b, a_and_c), (a_and_b, 1.0, 0.0), (a_and_c, 0.0, 1.0)
        return Neighbourhood(from_cycle * CYCLE_NS, rows)

    hours = hour(1, a_and_b=0.5, a_and_c=0.1), hour(2, a_and_b=0.1, a_and_c=0.5)
    orders = (NodeNeighbourhoods(ROOT, hours),)
    plan = plan_of(dict.fromkeys("abc", 100.0), cycles=3, neighbourhoods=orders)
    # 30 kW of each: a lacks 20 of them.
    _, sent = run_in_memory(plan, Profile(np.array([[10.0, 80.0, 80.0]] * 3), np.full(3, 90.0)))
    helpers = [
        [leaf for leaf in "abc" if sent.of(SETPOINT.of(leaf))[cycle].help_given]
        for cycle in range(3)
    ]
    assert helpers == [["c"], ["c"], ["b"]]


def test_a_run_that_is_stopped_ends_after_the_cycle_under_way() -> None:
    sent = Sent()
    run = MemoryRun(PLAN, PROFILE, sent)
    cycles = run.cycles()
    assert next(cycles) == 0
    run.stop()
    assert list(cycles) == [1]
    assert sent.of(PRODUCTION.of(ROOT)).get(1) is not None
    assert sent.of(DISPATCH.of(ROOT)).get(2) is None


def test_a_run_that_cannot_go_on_says_who_waits_for_what() -> None:
    # Without a dispatch that it can use the central controller sends no setpoints.
    profile = Profile(PROFILE.mpp_kw, np.array([np.nan, 80.0, 80.0]))
    with pytest.raises(FailureError, match=r"cycle 0: .* central; a waits for a/setpoint, b"):
        list(MemoryRun(PLAN, profile).cycles())
