"""A dispatch that asks for the impossible is clamped; one that is no number is not used."""

from __future__ import annotations

import math

import pytest
from plans_by_hand import REAL_TIME, plan_of
from plants_by_hand import AtWork, at, dispatch, meter, report

from bus_schemas.messages import Notice
from bus_schemas.signals import DISPATCH, NOTICE, RESIDUAL, SETPOINT
from bus_schemas.tree import ROOT

FLOOR_KW = 0.05 * 300.0
"""What `b` gives at least: an inverter is not curtailed further."""

PLAN = plan_of({"a": 100.0, "b": 300.0}, cycles=100, cycle_wall_ns=REAL_TIME)


def set_and_noticed(*dispatches_kw: float) -> tuple[list[float], list[int]]:
    """What is set of `b`, which has 3/4 of the rating, and what is noticed, for each one."""
    central = AtWork(PLAN, "central")
    set_kw: list[float] = []
    counts: list[int] = []
    for cycle, power_kw in enumerate(dispatches_kw):
        sent = central.hear(
            dispatch(cycle, power_kw, 400.0),
            meter(cycle, 0.0),
            *report("a", cycle, 100.0, 0.0),
            *report("b", cycle, 300.0, 0.0),
        )
        set_kw.append(at(sent, SETPOINT.of("b")).power_kw)
        notice = sent.get(NOTICE.of(ROOT))
        if isinstance(notice, Notice):
            counts.append(notice.count)
    return set_kw, counts


def test_clamped_dispatches_are_counted_together() -> None:
    set_kw, counts = set_and_noticed(100.0, -1.0, 500.0, 200.0)
    assert set_kw == [75.0, FLOOR_KW, 300.0, 150.0]
    assert counts == [1, 2]


@pytest.mark.parametrize("rating_kw", [0.0, -400.0, math.nan, math.inf, 5e-324])
def test_a_dispatch_without_a_rating_to_share_by_is_not_used(rating_kw: float) -> None:
    central = AtWork(PLAN, "central")
    central.hear(dispatch(0, 200.0, rating_kw), meter(0, 0.0))
    central.hear(*report("a", 0, 100.0, 0.0))
    central.at_deadline("solve")
    assert central.loop.dropped == {(str(DISPATCH.of(ROOT)), "absurd"): 1}


def test_before_the_first_dispatch_nothing_is_set_and_nothing_is_lacking() -> None:
    central = AtWork(PLAN, "central")
    central.hear(*report("a", 0, 80.0, 80.0), *report("b", 0, 90.0, 90.0))
    sent = central.at_deadline("solve")
    assert at(sent, RESIDUAL.of(ROOT)).power_kw == 170.0
    assert SETPOINT.of("a") not in sent
