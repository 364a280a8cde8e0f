"""Requests of a regulation signal: which are fulfilled, and when there are any."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from runs_by_hand import NOON, run_of

from recordings.read.series import RunSeries
from results.regulation import offered_cycles, regulation_figures, requests_fulfilled

CAPACITY_KW = 200.0
COMMITMENT_KW = 400.0


def regulated_run(
    regulation_kw: ArrayLike,
    error_kw: ArrayLike = 0.0,
    available_kw: ArrayLike = 900.0,
    cycle_s: float = 1.0,
    start: str = NOON,
) -> RunSeries:
    """A run that delivers what is desired but for an error."""
    regulation_kw = np.asarray(regulation_kw, dtype=float)
    return run_of(
        np.full_like(regulation_kw, COMMITMENT_KW),
        available_kw,
        COMMITMENT_KW + regulation_kw + np.asarray(error_kw, dtype=float),
        regulation_kw=regulation_kw,
        capacity_kw=CAPACITY_KW,
        cycle_s=cycle_s,
        start=start,
    )


def regulated(*powers_kw: Any, **of_run: Any) -> dict[str, float | None]:
    """The figures of such a run."""
    return regulation_figures(regulated_run(*powers_kw, **of_run))


def test_a_request_is_fulfilled_if_every_cycle_in_it_is_within_the_tolerance() -> None:
    found = regulated(
        [50.0, 50.0, -80.0, -80.0, 120.0, 120.0, 10.0, 10.0, -20.0, -20.0],
        [0.0, 0.5, -2.0, 0.0, 0.0, 5.0, 30.0, -30.0, 0.5, 0.5],
        # within 1  short of 1  over         short       within 1
    )
    assert found == pytest.approx(
        {
            "capacity": CAPACITY_KW,
            "offered": 10 / 3600,
            "signal-mileage": 2.35 * 360,  # (0.65 + 1 + 0.55 + 0.15) in 10 s
            "regd-strict": 40.0,
            "regd-feasible-strict": 40.0,
            "regd": 80.0,
            "regd-feasible": 80.0,
        }
    )


def test_a_request_is_feasible_if_the_plant_could_meet_it_in_every_cycle() -> None:
    found = regulated(
        [50.0, 50.0, 100.0, 100.0, 100.0, 100.0],
        # feasible   not, yet fulfilled  feasible, short
        [0.0, 0.0, -0.5, 0.0, 0.0, -20.0],
        available_kw=[900.0, 900.0, 499.5, 600.0, 500.0, 600.0],
    )
    names = ("regd-strict", "regd", "regd-feasible-strict", "regd-feasible")
    assert [found[name] for name in names] == pytest.approx([200 / 3, 200 / 3, 50.0, 50.0])
    none = regulated([5.0, 5.0], -395.0, available_kw=10.0)
    assert "regd-feasible" not in none


@pytest.mark.parametrize(
    ("percent", "of_all", "of_feasible"),
    # Errors of the requests, in % of the 200 kW offered: 2, 5, 10 (not feasible), 20, 25.
    [(1, 0.0, 0.0), (2, 20.0, 25.0), (5, 40.0, 50.0), (10, 60.0, 50.0), (20, 80.0, 75.0)],
)
def test_a_tolerance_may_be_a_share_of_the_capacity(
    percent: float, of_all: float, of_feasible: float
) -> None:
    run = regulated_run(
        [50.0, 50.0, -80.0, -80.0, 150.0, 150.0, 10.0, 10.0, -20.0, -20.0],
        [0.0, 4.0, -10.0, 2.0, -20.0, 0.0, 40.0, 0.0, -40.0, -50.0],
        available_kw=[900.0] * 4 + [530.0, 900.0] + [900.0] * 4,
    )
    assert requests_fulfilled(run, CAPACITY_KW * percent / 100.0) == (of_all, of_feasible)


@pytest.mark.parametrize(
    ("regulation", "offered"),
    [
        ("000+0-0000", "0001110000"),
        ("++++", "1111"),
        ("0000", "0000"),
        ("", ""),
        ("+" + "0" * 59 + "-", "1" * 61),
        ("+" + "0" * 60 + "-0", "1" + "0" * 60 + "10"),
    ],
)
def test_a_zero_of_less_than_a_minute_between_requests_is_a_request(
    regulation: str, offered: str
) -> None:
    regulation_kw = np.array(["-0+".index(sign) - 1.0 for sign in regulation])
    found = offered_cycles(regulation_kw, cycle_s=1.0)
    assert "".join("1" if cycle else "0" for cycle in found) == offered
