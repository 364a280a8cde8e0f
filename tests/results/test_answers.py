"""The plant's answers, against numbers worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from runs_by_hand import RATING_KW, run_of

from bus_schemas.messages import Dispatch
from bus_schemas.tree import PLANT
from results.answers import Answer, answer, answers, judged
from scenarios.scenario import AnswerBudgets

CYCLE_S = 2.0


def answered(
    dispatch_kw: Sequence[float], delivered_kw: Sequence[float], available_kw: float = 1e4
) -> Answer:
    """The answer to a dispatch after 100 kW, in cycles of 2 s."""
    dispatch, delivered = np.array(dispatch_kw), np.array(delivered_kw)
    able = np.full(len(dispatch), available_kw)
    return answer(dispatch, delivered, able, 100.0, CYCLE_S, RATING_KW)


def test_a_step_has_its_times_its_overshoot_and_its_error_at_rest() -> None:
    # 400 kW up: nine tenths are at 460 kW. 1 % of the rating are 10 kW.
    found = answered([500.0] * 10, [200, 470, 530, 515, 505, 505, 505, 505, 505, 505])
    assert (found.ramp_s, found.settling_s) == (0.0, 10.0)
    assert found.overshoot_percent == pytest.approx(3.0)
    assert found.error_percent == pytest.approx(0.5)
    assert found.ramp_deviation_percent is None


@pytest.mark.parametrize(("rest", "error_percent"), [(2, None), (6, 0.0)])
def test_an_answer_that_is_cut_short_at_the_end_of_its_ramp_has_no_error_at_rest(
    rest: int, error_percent: float | None
) -> None:
    # Within 1 % at 495 kW the dispatch still moves, and the power follows a cycle later.
    dispatch = [200.0, 300.0, 400.0, 495.0, *[500.0] * rest]
    found = answered(dispatch, [100.0, *dispatch[:-1]])
    assert (found.error_percent, found.settling_s is None) == (error_percent, False)


def test_a_step_has_reaction_rise_settling_and_damping() -> None:
    # 400 kW up: a tenth is at 140 kW, nine tenths at 460 kW; the band is 2.5 % of it, 10 kW.
    found = answered([500.0] * 8, [130.0, 145.0, 300.0, 470.0, 511.0, 491.0, 500.0, 500.0])
    assert (found.reaction_s, found.rise_s) == (4.0, 4.0)
    assert found.settling_of_change_s == 12.0
    # 11 of 400 kW beyond it: exp(-pi z / sqrt(1 - z^2)) = 0.0275 for z = 0.7529.
    assert found.damping == pytest.approx(0.7529, abs=1e-4)


def test_a_step_of_the_frequency_is_answered_like_a_step_of_power() -> None:
    # 100 kW less for cycles 10 to 19. Of them 20, 60, 95, 104 are gone, then all.
    response = np.where((np.arange(30) >= 10) & (np.arange(30) < 20), -100.0, 0.0)
    given = np.full(30, 300.0)
    given[10:20] -= [20.0, 60.0, 95.0, 104.0, *[100.0] * 6]
    run = run_of(np.full(30, 300.0), 1e4, given)
    asked_kw = np.full(30, 300.0) + response
    (found,) = answers(replace(run, response_kw=response, desired_kw=asked_kw))
    assert (found.asked, found.ramp_s, found.duration_s) == ("frequency", 0.0, 10.0)
    assert (found.reaction_s, found.rise_s) == (1.0, 2.0)
    assert found.settling_of_change_s == 3.0, "half a per cent of the rating are 5 kW"
    # 4 % beyond it: exp(-pi z / sqrt(1 - z^2)) = 0.04 for z = 0.7156.
    assert found.damping == pytest.approx(0.7156, abs=1e-4)
    assert found.response_percent == pytest.approx(100.0 - 121.0 / 10.0)
    limits = AnswerBudgets(reaction_s=1.0, rise_s=1.0, damping=0.8, settling_s=5.0)
    assert judged((found,), limits)[0].missed == ("rise_s", "damping")


def test_a_ramp_is_judged_by_its_deviation_and_settles_after_its_end() -> None:
    found = answered([200.0, 300.0, 400.0, 400.0, 400.0], [180.0, 280.0, 370.0, 402.0, 400.0])
    assert (found.ramp_s, found.rise_s, found.settling_s) == (4.0, None, 4.0)
    assert found.ramp_deviation_percent == pytest.approx(2.0)


def test_cycles_without_the_sun_do_not_count_and_what_never_settles_says_so() -> None:
    assert answered([500.0] * 4, [300.0] * 4).settling_s is None
    found = answered([500.0] * 4, [300.0] * 4, available_kw=300.0)
    assert (found.settling_s, found.error_percent, found.unable_percent) == (None, None, 100.0)


def order(cycle: int, power_kw: float | None, **more: Any) -> Dispatch:
    """The dispatch with which an order comes into force."""
    stated: dict[str, Any] = {"order_state": "holds", "order_cycle": cycle, **more}
    return Dispatch(
        *(cycle, 0, PLANT, ()),
        power_kw=power_kw or 0.0,
        plant_rating_kw=RATING_KW,
        commitment_kw=0.0,
        regulation_kw=0.0,
        order_source="command",
        order_power_kw=power_kw,
        **stated,
    )


def test_each_order_and_each_step_of_the_schedule_has_its_answer() -> None:
    commitment = np.array([100.0] * 10 + [300.0] * 30)
    dispatch = commitment.copy()
    dispatch[20:30] = 200.0
    orders = (order(20, 200.0), order(30, 200.0, order_cycle=20, order_state="over"))
    run = run_of(commitment, 1e4, dispatch, start="2010-04-01T12:00:00")
    found = answers(replace(run, dispatch_kw=dispatch, desired_kw=dispatch, orders=orders))
    assert [(one.asked, one.cycle, one.end_cycle) for one in found] == [
        ("schedule", 10, 20),
        ("command", 20, 30),
        ("schedule", 30, 40),
    ]
    assert [one.settling_s for one in found] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("follows", "overshoot_percent"),
    [
        ({}, 6.0),
        # 300 kW take 3 s by 10 % a second, and the delay comes on top.
        ({"ramp_percent_per_s": 10.0}, 2.0),
        ({"ramp_percent_per_s": 10.0, "delay_s": 1.0}, 1.0),
    ],
)
def test_out_of_saturation_what_stays_above_the_order_counts(
    follows: dict[str, Any], overshoot_percent: float
) -> None:
    # The sun allows 800 of 900 kW, then 500 kW are ordered.
    asked_kw = np.array([900.0] * 10 + [500.0] * 8)
    given_kw = [800.0] * 10 + [560.0, 540.0, 530.0, 520.0, 510.0, 500.0, 500.0, 500.0]
    run = run_of(asked_kw, 800.0, given_kw, **follows)
    ordered = replace(run, orders=(order(10, 500.0),))
    (found,) = answers(ordered)
    assert found.overshoot_percent == pytest.approx(overshoot_percent)


def test_orders_that_follow_each_other_are_one_signal_with_a_score() -> None:
    at = np.arange(0, 600, 4)
    powers = 500.0 + 200.0 * np.sin(2.0 * np.pi * at / 200.0)
    dispatch = np.repeat(powers, 4)
    orders = tuple(order(int(cycle), kw) for cycle, kw in zip(at, powers, strict=True))
    run = run_of(np.full(600, 100.0), 1e4, dispatch)
    (found,) = answers(replace(run, dispatch_kw=dispatch, desired_kw=dispatch, orders=orders))
    assert found.signal is not None
    assert found.signal.orders == 150
    assert found.score == pytest.approx(1.0)
    still = run_of(np.full(600, 100.0), 1e4, np.full(600, 500.0))
    (found,) = answers(replace(still, dispatch_kw=dispatch, desired_kw=dispatch, orders=orders))
    assert found.score is not None
    assert found.score < 0.4


def test_a_program_that_promises_a_rhythm_gives_a_signal_at_that_rhythm() -> None:
    at = range(0, 600, 40)
    dispatch = np.repeat(np.tile([300.0, 500.0, 400.0], 5), 40)
    run = run_of(np.full(600, 100.0), 1e4, dispatch)

    def counts(**more: Any) -> list[int]:
        orders = tuple(order(cycle, float(dispatch[cycle]), **more) for cycle in at)
        asked = replace(run, dispatch_kw=dispatch, desired_kw=dispatch, orders=orders)
        return [one.signal.orders if one.signal else 1 for one in answers(asked)]

    assert counts() == [1] * 15
    assert counts(order_renew_s=45.0) == [15]
    assert counts(order_renew_s=39.0) == [1] * 15


def test_an_order_that_the_frequency_cut_short_tells_what_it_asked_for() -> None:
    dispatch = np.concatenate([np.full(10, 100.0), np.arange(110.0, 510.0, 20.0)])
    response = np.where(np.arange(30) >= 20, 50.0, 0.0)
    run = run_of(np.full(30, 100.0), 1e4, dispatch + response)
    orders = (order(10, 490.0),)
    asked: dict[str, Any] = {"dispatch_kw": dispatch, "desired_kw": dispatch + response}
    cut, _ = judged(
        answers(replace(run, response_kw=response, orders=orders, **asked)),
        AnswerBudgets(settling_s=2.0),
    )
    assert (cut.asked, cut.to_kw, cut.end_cycle) == ("command", 490.0, 20)
    assert (cut.settling_s, cut.overshoot_percent, cut.missed) == (None, None, ())


def test_budgets_name_what_each_answer_missed() -> None:
    slow = answered([500.0] * 10, [200, 470, 530, 515, 505, 505, 505, 505, 505, 505])
    never = answered([500.0] * 10, [300.0] * 10)
    sunless = answered([500.0] * 10, [300.0] * 10, available_kw=300.0)
    limits = AnswerBudgets(rise_s=4.0, settling_s=9.0, overshoot_percent=2.0, error_percent=0.5)
    found = judged((slow, never, sunless), limits)
    assert [one.missed for one in found] == [
        ("settling_s", "overshoot_percent"),
        ("settling_s",),
        (),
    ]
    assert [one.verdict for one in found] == [False, False, True]
    assert [one.verdict for one in judged((slow,), None)] == [None]
