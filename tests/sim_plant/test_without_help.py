"""The baseline of every run: each inverter held to its share, with its delay and its ramp."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from plans_by_hand import plan_of

from agents.settings import FleetPlant
from sim_plant.without_help import powers_without_help_kw

TWO = {"c1/a": 100.0, "c1/b": 300.0}


def powers_kw(mpp_kw: ArrayLike, desired_kw: ArrayLike, **changes: object) -> NDArray[np.float64]:
    plan = plan_of(TWO, actuator="limit", **changes)
    return powers_without_help_kw(plan, np.array(mpp_kw), np.array(desired_kw), "limit")


def test_nobody_covers_for_a_shaded_inverter() -> None:
    assert powers_kw([[20.0, 300.0]], [200.0]).tolist() == [[20.0, 150.0]]


def test_a_step_comes_after_the_delay_and_within_the_ramp() -> None:
    sunny = np.full((6, 2), [100.0, 300.0])
    found = powers_kw(sunny, [200, 400, 400, 400, 400, 400], delay_s=1.5, ramp_percent_per_s=20.0)
    assert found.sum(axis=1) == pytest.approx([200, 200, 200, 280, 360, 400])


def test_a_cycle_without_a_dispatch_changes_nothing_and_is_not_zero() -> None:
    sunny = np.full((3, 2), [100.0, 300.0])
    found = powers_kw(sunny, [200, np.nan, 200], ramp_percent_per_s=20.0)
    assert found.sum(axis=1) == pytest.approx([200, 200, 200])


def test_a_plant_of_a_fleet_feeds_in_no_more_than_its_connection_carries() -> None:
    plan = plan_of(
        {"west/a": 100.0, "west/b": 100.0, "east/c": 200.0},
        plants=tuple(FleetPlant(name=name, export_limit_kw=150.0) for name in ("west", "east")),
    )
    sunny, promised = np.array([[100.0, 100.0, 200.0]]), np.array([390.0])
    found = powers_without_help_kw(plan, sunny, promised, "limit")
    assert found.tolist() == [[75.0, 75.0, 150.0]]
