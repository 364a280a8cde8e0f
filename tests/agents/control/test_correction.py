"""The integral correction: what the plant's meter shows to be wrong moves the target."""

import pytest

from agents.control.correction import (
    HIGHEST_CORRECTION,
    Response,
    corrected,
    follows_kw,
    missing_kw,
    shown_turns,
)

RATING_KW = 1000.0


def settled(loss_kw: float, cycle_s: float, seconds: float, delay_s: float = 0.0) -> list[float]:
    """Metered power, cycle by cycle, of a plant that delivers so much less than it is asked for."""
    late = round(delay_s / cycle_s)
    correction_kw, found = 0.0, [500.0 - loss_kw] * (late + 1)
    for _ in range(round(seconds / cycle_s)):
        read_kw = found[-1 - late]
        correction_kw = corrected(
            correction_kw, 500.0 - read_kw, False, RATING_KW, cycle_s, delay_s
        )
        found.append(500.0 + correction_kw - loss_kw)
    return found


@pytest.mark.parametrize("cycle_s", [0.1, 1.0, 10.0, 60.0])
def test_a_constant_loss_is_made_up_for_without_swinging(cycle_s: float) -> None:
    metered_kw = settled(20.0, cycle_s, 20.0 * max(cycle_s, 1.0))
    assert metered_kw[-1] == pytest.approx(500.0, abs=0.01)
    assert metered_kw == sorted(metered_kw)


@pytest.mark.parametrize("delay_s", [1.0, 7.0, 20.0])
def test_nor_does_it_swing_where_readings_come_late(delay_s: float) -> None:
    metered_kw = settled(20.0, 1.0, 20.0 * (1.0 + delay_s) ** 2, delay_s)
    assert metered_kw[-1] == pytest.approx(500.0, abs=0.01)
    assert max(metered_kw) < 500.01


def test_it_takes_the_same_time_whatever_the_cycle() -> None:
    fast, slow = settled(20.0, 0.1, 3.0), settled(20.0, 1.0, 3.0)
    assert fast[-1] == pytest.approx(slow[-1], abs=2.5)


def test_what_is_expected_follows_a_new_aim_as_fast_as_the_inverters_ramp() -> None:
    slow = Response(ramp_kw_per_s=100.0)
    first_kw = follows_kw(1000.0, 4000.0, 1.0, slow)
    assert (first_kw, follows_kw(first_kw, 4000.0, 1.0, slow)) == (1100.0, 1200.0)
    assert follows_kw(1000.0, 4000.0, 1.0, Response()) == 4000.0


@pytest.mark.parametrize(
    ("metered_kw", "lacks_kw"), [(900.0, 100.0), (1000.0, 0.0), (2500.0, 0.0), (4200.0, -200.0)]
)
def test_what_is_still_on_its_way_is_not_missing(metered_kw: float, lacks_kw: float) -> None:
    assert missing_kw((4000.0, 1000.0), metered_kw) == lacks_kw


@pytest.mark.parametrize("cycle_s", [0.1, 0.2, 0.7, 1.0])
def test_a_delay_of_whole_cycles_lets_the_meter_show_one_aim_more_for_each(cycle_s: float) -> None:
    shown = [shown_turns(cycles * cycle_s, cycle_s, Response()) for cycles in range(30)]
    assert shown == list(range(1, 31))
    assert shown_turns(2.5 * cycle_s, cycle_s, Response()) == 4


def test_it_never_exceeds_its_share_of_the_rating() -> None:
    most_kw = HIGHEST_CORRECTION * RATING_KW
    assert settled(300.0, 1.0, 100.0)[-1] == 200.0 + most_kw
    assert settled(-300.0, 1.0, 100.0)[-1] == 800.0 - most_kw
