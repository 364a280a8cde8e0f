"""Requests of a regulation signal: which are fulfilled, and when there are any."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs_by_hand import RATING_KW, run_of

from studies.metrics.regulation import (
    RequestsFulfilled,
    offered_cycles,
    regulation_metrics,
    requests_fulfilled,
)

CAPACITY_KW = 200.0


def test_a_request_is_fulfilled_if_every_cycle_in_it_is_within_the_tolerance() -> None:
    regulation_kw = [50.0, 50.0, -80.0, -80.0, 120.0, 120.0, 10.0, 10.0, -20.0, -20.0]
    deviation_kw = [0.0, 0.5, -2.0, 0.0, 0.0, 5.0, 30.0, -30.0, 0.5, 0.5]
    #               within 1  short of 1  over         short       within 1
    run = run_of(
        np.full(10, 400.0),
        possible_kw=900.0,
        delivered_kw=400.0 + np.add(regulation_kw, deviation_kw),
        regulation_kw=regulation_kw,
        capacity_kw=CAPACITY_KW,
    )
    found = regulation_metrics(run)
    assert found is not None
    assert found.requests == (
        RequestsFulfilled(
            0.1, 1.0, requests=5, fulfilled=2, short=2, over=1, feasible=5, feasible_fulfilled=2
        ),
        RequestsFulfilled(
            1.0, 10.0, requests=5, fulfilled=4, short=1, over=0, feasible=5, feasible_fulfilled=4
        ),
    )
    assert [one.fulfilled_percent for one in found.requests] == [40.0, 80.0]
    assert found.capacity_kw == CAPACITY_KW
    assert found.offered_h == pytest.approx(10 / 3600)
    # (0.65 + 1 + 0.55 + 0.15) in 10 s
    assert found.signal_mileage_per_hour == pytest.approx(2.35 * 360)
    assert found.performance is None  # of 10 s


def test_a_request_is_feasible_if_the_plant_could_meet_it_in_every_cycle() -> None:
    run = run_of(
        np.full(6, 400.0),
        possible_kw=[900.0, 900.0, 499.5, 600.0, 500.0, 600.0],
        #              feasible      not, yet fulfilled  feasible, short
        delivered_kw=[450.0, 450.0, 499.5, 500.0, 500.0, 480.0],
        regulation_kw=[50.0, 50.0, 100.0, 100.0, 100.0, 100.0],
        capacity_kw=CAPACITY_KW,
    )
    found = regulation_metrics(run)
    assert found is not None
    for one in found.requests:
        assert (one.requests, one.fulfilled) == (3, 2)
        assert (one.feasible, one.feasible_fulfilled) == (2, 1)
        assert one.feasible_fulfilled_percent == 50.0


def test_where_no_request_was_feasible_no_share_of_them_is_defined() -> None:
    power_kw = [10.0, 10.0]
    run = run_of([400.0, 400.0], power_kw, power_kw, regulation_kw=[5.0, 5.0], capacity_kw=5.0)
    found = regulation_metrics(run)
    assert found is not None
    assert found.requests[0].feasible_fulfilled_percent is None


def test_requests_begin_at_the_even_seconds_of_the_clock() -> None:
    regulation_kw = [10.0, 20.0, 20.0, 30.0]
    run = run_of(
        np.zeros(4),
        possible_kw=900.0,
        delivered_kw=[10.0, 20.0, 90.0, 30.0],
        regulation_kw=regulation_kw,
        capacity_kw=CAPACITY_KW,
        start="2010-04-01T12:00:01",
    )
    found = regulation_metrics(run)
    assert found is not None
    assert (found.requests[0].requests, found.requests[0].fulfilled) == (3, 2)


def test_a_cycle_longer_than_a_request_is_a_request() -> None:
    run = run_of(
        np.zeros(3),
        possible_kw=900.0,
        delivered_kw=[10.0, 90.0, 20.0],
        regulation_kw=[10.0, 20.0, 20.0],
        capacity_kw=CAPACITY_KW,
        cycle_s=10.0,
    )
    found = regulation_metrics(run)
    assert found is not None
    assert (found.requests[0].requests, found.requests[0].fulfilled) == (3, 2)


def test_only_the_time_counts_in_which_regulation_is_offered() -> None:
    offered = np.arange(600) // 100 % 2 == 1
    regulation_kw = np.where(offered, 50.0, 0.0)
    run = run_of(
        np.full(600, 400.0),
        possible_kw=900.0,
        delivered_kw=np.where(offered, 450.0, 0.0),  # nothing at all while it is not offered
        regulation_kw=regulation_kw,
        capacity_kw=CAPACITY_KW,
    )
    found = regulation_metrics(run)
    assert found is not None
    assert found.requests[0].requests == 150
    assert found.requests[0].fulfilled_percent == 100.0
    assert found.offered_h == pytest.approx(300 / 3600)
    assert found.signal_mileage_per_hour == 0.0  # the steps into the offer are no signal


def test_a_plant_that_offers_no_regulation_has_no_such_metrics() -> None:
    assert regulation_metrics(run_of(np.full(10, 400.0), 900.0, 400.0)) is None
    silent = run_of(np.full(10, 400.0), 900.0, 400.0, capacity_kw=CAPACITY_KW)
    assert regulation_metrics(silent) is None


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


@given(
    st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=40),
    st.floats(0.0, 5.0),
    st.floats(0.0, 5.0),
)
def test_a_wider_tolerance_fulfils_no_fewer_requests(
    deviation: list[float], one: float, other: float
) -> None:
    request = np.arange(len(deviation), dtype=np.int64) // 2
    tolerances = sorted((one, other))
    able = np.ones(len(deviation), dtype=bool)
    narrow, wide = requests_fulfilled(np.array(deviation), request, able, RATING_KW, tolerances)
    assert narrow.fulfilled <= wide.fulfilled
    for found in (narrow, wide):
        assert found.fulfilled + found.short + found.over == found.requests
        assert found.requests == (len(deviation) + 1) // 2
