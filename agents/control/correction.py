"""The integral correction: moves the target by what the plant's meter shows to be wrong.

Its reading shows the effect of all errors: of estimates, delays and losses. What it shows need not
be an error: inverters take their time, and without headroom the sky decides. So an error teaches
nothing where

* no inverter was curtailed in a turn that the meter may still show;
* it lies between aims that the meter may still show;
* inverters follow on a ramp and the power comes nearer to the aim.

An error that is gone before anything can be done about it comes back with the opposite sign if it
is corrected. So how much of what would be missing is corrected is learned, as the share of a trend
that is expected to go on is (see `forecast`): by a regression that fades.
"""

from __future__ import annotations

from math import ceil, inf, isnan, nan
from typing import Final, NamedTuple

from agents.control.grid import GridLaw, gross_kw

GAIN_PER_S: Final = 0.4
"""Share of the error that is added in a second."""

HIGHEST_GAIN: Final = 0.4
"""Share of it that is added at once, at most: in long cycles most of an error is a passing cloud's.

If it comes later still, the share falls with the delay: an integrator is stable up to
2 sin(pi / (4 d + 2)) with a delay of d turns."""

HIGHEST_CORRECTION: Final = 0.1
"""Largest correction up and down, as a share of the plant's rating."""

SHARE_MEMORY_S: Final = 600.0
"""Time constant with which the share that is corrected is learned [s]."""

SHARE_ASSUMED: Final = 0.01
"""It takes corrections of this share of the rating to outweigh that at first all is corrected."""

LEAST_WAY: Final = 0.001
"""Share of an error by which power that is on its way changes it from one turn to the next."""

ERROR_MEMORY_S: Final = 20.0
"""Time constant of the mean error of the plant's power [s]."""


class CorrectionLaw(NamedTuple):
    """How a plant corrects its target.

    is_on: Whether it does.
    rating_kw: Rating of the plant.
    cycle_s, turn_s: Time between two readings of the meter, and between two corrections [s].
    delay_s: Longest time until a command takes effect [s].
    is_ramped: Whether some inverters follow commands on a ramp, or on one that is not known.
    offset_kw, offset_errors: How far above what is desired it aims: by a constant, and by so many
        times its mean error.
    kept_turns: How many aims are kept.
    """

    is_on: bool
    rating_kw: float
    cycle_s: float
    turn_s: float
    delay_s: float
    is_ramped: bool
    offset_kw: float
    offset_errors: float
    kept_turns: int


class Correction(NamedTuple):
    """What the central controller knows of the plant's meter.

    shown_kw: The aims of its last turns, the newest first: what the meter should show. NaN: all
        inverters were free, or there was no such turn.
    aim_kw: What it aims at now, before the correction.
    lacking_kw: What would be missing without a correction, as a mean that fades.
    correction_kw: What is added to the aim: a share of that.
    helped_kw2, tried_kw2: How well `lacking_kw` told what came: fading sums of both multiplied, and
        of its square.
    error_kw: Mean distance between aim and meter.
    metered_kw, readings: Sum and number of the readings since the last turn.
    last_kw: Their mean before the last turn; NaN: there was none.
    """

    shown_kw: tuple[float, ...]
    aim_kw: float = 0.0
    lacking_kw: float = 0.0
    correction_kw: float = 0.0
    helped_kw2: float = 0.0
    tried_kw2: float = 0.0
    error_kw: float = 0.0
    metered_kw: float = 0.0
    readings: int = 0
    last_kw: float = nan


def nothing_metered(law: CorrectionLaw) -> Correction:
    return Correction((nan,) * law.kept_turns)


def with_reading(last: Correction, power_kw: float) -> Correction:
    return Correction(
        shown_kw=last.shown_kw,
        aim_kw=last.aim_kw,
        lacking_kw=last.lacking_kw,
        correction_kw=last.correction_kw,
        helped_kw2=last.helped_kw2,
        tried_kw2=last.tried_kw2,
        error_kw=last.error_kw,
        metered_kw=last.metered_kw + power_kw,
        readings=last.readings + 1,
        last_kw=last.last_kw,
    )


def corrected(
    last: Correction, desired_kw: float, possible_kw: float, delay_s: float, law: CorrectionLaw
) -> Correction:
    """Learn from the readings since the last turn, and aim at what is desired now.

    Parameters
    ----------
    desired_kw, possible_kw
        What the plant is to give at its meter, and what its inverters could give.
    delay_s
        Time that messages need to the inverters and back [s], in addition to the cycle that a
        setpoint holds.
    """
    is_free = desired_kw >= possible_kw
    error_kw, metered_kw = last.error_kw, last.last_kw
    lacking_kw, helped_kw2, tried_kw2 = last.lacking_kw, last.helped_kw2, last.tried_kw2
    if last.readings > 0:
        metered_kw = last.metered_kw / last.readings
        delay_s += law.delay_s
        turns = shown_turns(delay_s, law.turn_s)
        missed_kw = _missing_kw(last, metered_kw, turns)
        time_s = last.readings * law.cycle_s
        if not isnan(missed_kw):
            error_kw += (abs(missed_kw) - error_kw) * time_s / (ERROR_MEMORY_S + time_s)
        is_on_its_way = law.is_ramped and (metered_kw - last.last_kw) * missed_kw > 0.0
        if is_on_its_way:  # What moves as the aims did gets no nearer to them.
            aims_way_kw = last.shown_kw[turns - 2] - last.shown_kw[turns - 1]
            nearer_kw = metered_kw - last.last_kw - aims_way_kw
            is_on_its_way = abs(nearer_kw) > LEAST_WAY * abs(missed_kw)
        if abs(missed_kw) > 0.0 and not is_on_its_way:
            would_kw = missed_kw + last.correction_kw
            # A large error that nothing told of counts for no more than the correction itself.
            told_kw = min(max(would_kw, -abs(lacking_kw)), abs(lacking_kw))
            kept = SHARE_MEMORY_S / (SHARE_MEMORY_S + time_s)
            helped_kw2 = kept * helped_kw2 + told_kw * lacking_kw
            tried_kw2 = kept * tried_kw2 + lacking_kw * lacking_kw
            gain = min(GAIN_PER_S * time_s, HIGHEST_GAIN / (1.0 + delay_s / time_s))
            most_kw = HIGHEST_CORRECTION * law.rating_kw
            lacking_kw = min(max(lacking_kw + gain * (would_kw - lacking_kw), -most_kw), most_kw)
    if is_free or not law.is_on:
        lacking_kw = 0.0
    aim_kw = desired_kw + law.offset_kw + law.offset_errors * error_kw
    return Correction(
        shown_kw=(nan if is_free else aim_kw, *last.shown_kw[:-1]),
        aim_kw=aim_kw,
        lacking_kw=lacking_kw,
        correction_kw=_share(helped_kw2, tried_kw2, law.rating_kw) * lacking_kw,
        helped_kw2=helped_kw2,
        tried_kw2=tried_kw2,
        error_kw=error_kw,
        metered_kw=0.0,
        readings=0,
        last_kw=metered_kw,
    )


def _share(helped_kw2: float, tried_kw2: float, rating_kw: float) -> float:
    """Return how much of what would be missing is corrected."""
    assumed_kw2 = (SHARE_ASSUMED * rating_kw) ** 2
    return max((helped_kw2 + assumed_kw2) / (tried_kw2 + assumed_kw2), 0.0)


def corrected_kw(known: Correction, law: CorrectionLaw, grid: GridLaw) -> float:
    """Return the target of the inverters together [kW].

    Losses are known ahead, so that the correction need not find them.
    """
    needed_kw = gross_kw(known.aim_kw, grid) if law.is_on else known.aim_kw
    lowest_kw = min(grid.pmin_kw, 0.0)  # A plant of a fleet may charge its storages.
    return min(max(needed_kw + known.correction_kw, lowest_kw), law.rating_kw)


def shown_turns(delay_s: float, turn_s: float) -> int:
    """Return of how many turns, the last one included, the meter may still show the aims.

    One more than the delay takes: a new aim first shows the maxima that limits have hidden.
    """
    # A quotient of whole cycles is whole: 3 cycles of 0.1 s divide to 3.0000000000000004.
    return 2 + ceil(round(delay_s / turn_s, 6))


def _missing_kw(known: Correction, metered_kw: float, turns: int) -> float:
    """Return what the meter lacks of what it should show [kW]; negative if it shows more.

    NaN: what it should show is not known.

    It may show any power between the aims that it may still show: against the newest alone, the
    correction would add up what is only on its way, and overshoot.
    """
    lowest_kw, highest_kw = inf, -inf
    for turn in range(turns):
        # What an aim before the first one lets the meter show is not known.
        if turn >= len(known.shown_kw) or isnan(known.shown_kw[turn]):
            return nan
        lowest_kw = min(lowest_kw, known.shown_kw[turn])
        highest_kw = max(highest_kw, known.shown_kw[turn])
    return min(max(metered_kw, lowest_kw), highest_kw) - metered_kw
