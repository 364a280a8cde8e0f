"""The integral correction: what the plant's meter shows to be wrong moves the target."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from agents.control.correction import (
    HIGHEST_CORRECTION,
    CorrectionLaw,
    corrected,
    corrected_kw,
    nothing_metered,
    shown_turns,
    with_reading,
)
from agents.control.grid import GridLaw, gross_kw, net_kw

RATING_KW = 1000.0


def law_of(cycle_s: float, delay_s: float = 0.0, *, is_ramped: bool = False) -> CorrectionLaw:
    return CorrectionLaw(True, RATING_KW, cycle_s, cycle_s, delay_s, is_ramped, 0.0, 0.0, 60)


def settled(loss_kw: float, cycle_s: float, seconds: float, delay_s: float = 0.0) -> list[float]:
    """Metered power, cycle by cycle, of a plant that delivers so much less than it is asked for."""
    law, late = law_of(cycle_s, delay_s), round(delay_s / cycle_s)
    known, found = nothing_metered(law), [500.0 - loss_kw] * (late + 1)
    for _ in range(round(seconds / cycle_s)):
        known = corrected(with_reading(known, found[-1 - late]), 500.0, inf, 0.0, law)
        found.append(corrected_kw(known, law, GridLaw()) - loss_kw)
    return found


@pytest.mark.parametrize("cycle_s", [0.1, 1.0, 10.0, 60.0])
def test_a_constant_loss_is_made_up_for_without_swinging(cycle_s: float) -> None:
    metered_kw = settled(20.0, cycle_s, 22.0 * max(cycle_s, 1.0))
    assert metered_kw[-1] == pytest.approx(500.0, abs=0.01)
    assert metered_kw == sorted(metered_kw)


@pytest.mark.parametrize("delay_s", [1.0, 7.0, 20.0])
def test_nor_does_it_swing_where_readings_come_late(delay_s: float) -> None:
    metered_kw = settled(20.0, 1.0, 21.0 * (1.0 + delay_s) ** 2, delay_s)
    assert metered_kw[-1] == pytest.approx(500.0, abs=0.01)
    assert max(metered_kw) < 500.01


@pytest.mark.parametrize("drift_kw", [0.02, -0.02])
def test_an_error_that_lasts_is_corrected_while_the_dispatch_drifts(drift_kw: float) -> None:
    law = law_of(1.0, is_ramped=True)
    known, metered_kw = nothing_metered(law), 480.0
    for turn in range(30):
        wanted_kw = 500.0 + drift_kw * turn
        known = corrected(with_reading(known, metered_kw), wanted_kw, inf, 0.0, law)
        metered_kw = corrected_kw(known, law, GridLaw()) - 20.0
    assert metered_kw == pytest.approx(wanted_kw, abs=0.5)


@pytest.mark.parametrize(
    ("delay_s", "turn_s", "turns"), [(0.0, 1.0, 2), (2.5, 1.0, 5), (3 * 0.1, 0.1, 5), (1.0, 6.0, 3)]
)
def test_a_part_of_a_turn_counts_as_one_in_which_the_meter_may_show_an_older_aim(
    delay_s: float, turn_s: float, turns: int
) -> None:
    assert shown_turns(delay_s, turn_s) == turns


def test_losses_that_are_known_need_no_correction() -> None:
    law, grid = law_of(1.0), GridLaw(loss_kw=2.0, loss_per_kw=1.5e-5)
    known = corrected(nothing_metered(law), 500.0, 900.0, 0.0, law)
    asked_kw = corrected_kw(known, law, grid)
    assert net_kw(asked_kw, grid) == pytest.approx(500.0)
    known = corrected(with_reading(known, net_kw(asked_kw, grid)), 500.0, 900.0, 0.0, law)
    assert known.correction_kw == pytest.approx(0.0)
    # Which the paper's rule does not know.
    known = corrected(nothing_metered(law), 500.0, 900.0, 0.0, law._replace(is_on=False))
    assert corrected_kw(known, law._replace(is_on=False), grid) == 500.0 < gross_kw(500.0, grid)


def test_correcting_takes_the_same_time_in_every_cycle_length() -> None:
    fast, slow = settled(20.0, 0.1, 3.2), settled(20.0, 1.0, 5.0)
    assert fast[-1] == pytest.approx(slow[-1], abs=2.5)


def corrections_kw(
    law: CorrectionLaw, wanted_kw: list[float], metered_kw: list[float], possible_kw: list[float]
) -> list[float]:
    """Return the correction in each turn; `metered_kw` is of the interval before it."""
    known, found = nothing_metered(law), []
    for wanted, metered, possible in zip(wanted_kw, metered_kw, possible_kw, strict=True):
        known = corrected(with_reading(known, metered), wanted, possible, 0.0, law)
        found.append(known.correction_kw)
    return found


def test_power_on_its_way_is_not_corrected() -> None:
    wanted_kw = [100.0] * 4 + [400.0] * 5
    metered_kw = [100.0] * 7 + [400.0] * 2
    assert not any(corrections_kw(law_of(1.0, 2.0), wanted_kw, metered_kw, [inf] * 9))
    # Beyond both aims it is an error all the same.
    metered_kw[6] = 80.0
    assert corrections_kw(law_of(1.0, 2.0), wanted_kw, metered_kw, [inf] * 9)[6] > 0.0


def test_on_a_ramp_only_an_error_that_does_not_shrink_teaches() -> None:
    wanted_kw, metered_kw = [100.0] * 4 + [400.0] * 9, [100.0] * 5 + [*range(140, 300, 20)]
    assert not any(corrections_kw(law_of(1.0, is_ramped=True), wanted_kw, metered_kw, [inf] * 13))
    metered_kw[-1] = metered_kw[-2]
    assert corrections_kw(law_of(1.0, is_ramped=True), wanted_kw, metered_kw, [inf] * 13)[-1] > 0.0


def test_turns_in_which_all_inverters_were_free_teach_nothing() -> None:
    wanted_kw, possible_kw = [800.0] * 5 + [300.0] * 4, [600.0] * 9
    metered_kw = [600.0] * 6 + [300.0] * 3
    assert not any(corrections_kw(law_of(1.0), wanted_kw, metered_kw, possible_kw))


@pytest.mark.parametrize("cycle_s", [0.1, 1.0, 10.0])
def test_errors_that_are_gone_before_they_are_corrected_are_soon_left_alone(cycle_s: float) -> None:
    law, random = law_of(cycle_s), np.random.default_rng(5)
    known, corrections_kw = nothing_metered(law), []
    for error_kw in random.choice([-50.0, 50.0], 3000):
        known = corrected(
            with_reading(known, 500.0 + known.correction_kw + error_kw), 500.0, inf, 0.0, law
        )
        corrections_kw.append(abs(known.correction_kw))
    # Without learning that is 5 kW in the shortest cycles, and 20 in the others.
    assert np.mean(corrections_kw[-1000:]) < 2.0
    # A constant error is corrected again, wholly.
    for _ in range(round(3000 / cycle_s)):
        known = corrected(with_reading(known, 480.0 + known.correction_kw), 500.0, inf, 0.0, law)
    assert known.correction_kw == pytest.approx(20.0, rel=0.05)


def test_the_correction_never_exceeds_its_share_of_the_rating() -> None:
    most_kw = HIGHEST_CORRECTION * RATING_KW
    assert settled(300.0, 1.0, 100.0)[-1] == 200.0 + most_kw
    assert settled(-300.0, 1.0, 100.0)[-1] == 800.0 - most_kw
