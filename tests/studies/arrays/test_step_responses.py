"""Steps of the dispatch under a steady sun: no overshoot, and about as fast as the paper's rule.

The random ones go over all that decides how a plant follows, and over all states that it may be in.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import get_args

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plans_by_hand import plan_of

from agents.settings import Actuator, Scheme
from sim_plant.profile import Profile
from studies.arrays.closed_loop import run_loop

TREES = {
    1: [*"abcdefgh"],
    2: [f"c{c}/{one}" for c in (1, 2) for one in "abcd"],
    3: [f"z{z}/c{c}/{one}" for z in (1, 2) for c in (1, 2) for one in "ab"],
    4: [
        f"y{y}/z{z}/c{c}/{one}" for y in (1, 2) for z in (1, 2) for c in (1, 2) for one in "ab"[:1]
    ],
}
RATING_KW = 4000.0
TOLERANCE_KW = 0.01 * RATING_KW
FOLLOWS: list[tuple[float, float | None]] = [
    *((0.0, ramp) for ramp in (None, 33.0, 20.0, 10.0, 3.0)),
    *((delay_s, ramp) for delay_s in (1.0, 3.0) for ramp in (None, 20.0, 10.0, 3.0)),
]
"""Delay [s] and ramp [% of the rating per second] of the inverters."""


@dataclass(frozen=True)
class Step:
    """A step to a share of what the sun allows, and where it comes from.

    before: Share that was dispatched before it; above 1 the plant was in saturation. None: the step
        is the beginning of the run.
    under_way_s: If given, the step before that one began so long ago, at `first`.
    """

    to: float
    before: float | None
    first: float = 0.3
    under_way_s: float | None = None


@dataclass(frozen=True)
class Found:
    overshoot_kw: float
    settled_cycles: int


def answer(
    step: Step,
    scheme: Scheme,
    actuator: Actuator,
    follows: tuple[float, float | None],
    cycle_s: float,
    period: int,
    tiers: int,
    sun: float,
) -> Found:
    delay_s, ramp = follows
    takes_s = delay_s + (100.0 / ramp if ramp else 0.0) + 20.0 * period * cycle_s + 20.0
    rest = ceil(takes_s / cycle_s)
    parts = [(rest, step.to)]
    if step.under_way_s is not None:
        parts.insert(0, (max(ceil(step.under_way_s / cycle_s), 1), step.before or 0.0))
        parts.insert(0, (rest, step.first))
    elif step.before is not None:
        parts.insert(0, (rest, step.before))
    possible_kw = sun * RATING_KW
    dispatch_kw = np.concatenate([np.full(count, share * possible_kw) for count, share in parts])
    plan = plan_of(
        dict.fromkeys(TREES[tiers], RATING_KW / 8),
        cycles=len(dispatch_kw),
        cycle_ns=round(cycle_s * 1e9),
        period_cycles=(period, *[1] * (tiers - 1)),
        correction=True,
        delay_s=delay_s,
        ramp_percent_per_s=ramp,
    )
    profile = Profile(np.full((len(dispatch_kw), 8), possible_kw / 8), dispatch_kw)
    power_kw = run_loop(plan, profile, scheme, actuator).power_kw.sum(axis=1)
    at = len(dispatch_kw) - rest
    on_its_way = 0
    if step.under_way_s is not None:  # What was commanded before still comes.
        on_its_way = ceil(delay_s / cycle_s) + period
    return found_in(power_kw, at, on_its_way, step.to * possible_kw)


def found_in(power_kw: NDArray[np.float64], at: int, on_its_way: int, to_kw: float) -> Found:
    error_kw = power_kw[at:] - to_kw
    before_kw = power_kw[at + on_its_way - 1] - to_kw if at else -1.0
    beyond_kw = -np.sign(before_kw) * error_kw[on_its_way:]
    outside = np.flatnonzero(np.abs(error_kw) > TOLERANCE_KW)
    return Found(max(float(beyond_kw.max()), 0.0), int(outside[-1]) + 1 if len(outside) else 0)


share = st.floats(0.05, 0.95)
steps = st.one_of(
    st.builds(Step, to=share, before=st.none()),
    st.builds(Step, to=share, before=share | st.floats(1.02, 1.4)),
    st.builds(
        Step,
        to=share,
        before=share | st.floats(1.02, 1.4),
        first=share,
        under_way_s=st.floats(0.5, 20.0),
    ),
)


@settings(max_examples=200)
@given(
    steps,
    st.sampled_from(get_args(Actuator)),
    st.sampled_from(FOLLOWS),
    st.sampled_from([0.1, 1.0, 4.0, 10.0]),
    st.sampled_from([1, 4]),
    st.integers(1, 4),
    st.floats(0.5, 1.0),
)
@example(Step(0.55, None), "limit", (1.0, 10.0), 1.0, 1, 2, 0.8)
@example(Step(0.62, 1.3), "limit", (0.0, None), 1.0, 1, 2, 0.8)
def test_a_step_overshoots_by_a_percent_at_most_and_hardly_settles_later_than_by_the_papers_rule(
    step: Step,
    actuator: Actuator,
    follows: tuple[float, float | None],
    cycle_s: float,
    period: int,
    tiers: int,
    sun: float,
) -> None:
    how = actuator, follows, cycle_s, period, tiers, sun
    found, paper = answer(step, "predictive", *how), answer(step, "paper", *how)
    assert found.overshoot_kw <= TOLERANCE_KW or found.overshoot_kw <= paper.overshoot_kw
    assert found.overshoot_kw <= paper.overshoot_kw + 0.005 * RATING_KW
    assert found.settled_cycles <= paper.settled_cycles + 2 * period


@pytest.mark.parametrize("follows", FOLLOWS, ids=str)
def test_out_of_saturation_nothing_is_left_to_wind_down(
    follows: tuple[float, float | None],
) -> None:
    found = answer(Step(0.6, 1.3), "predictive", "limit", follows, 1.0, 1, 2, 0.8)
    assert found.overshoot_kw < 0.001 * RATING_KW
