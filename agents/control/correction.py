"""The integral correction: moves the target by what the plant's meter shows to be wrong.

Its reading shows the effect of all errors: of estimates, delays and losses.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf
from typing import Final, NamedTuple

GAIN_PER_S: Final = 0.4
"""Share of the error that is added in a second."""

HIGHEST_GAIN: Final = 0.4
"""Share of it that is added at once, at most: in long cycles most of an error is a passing cloud's.

If it comes later still, the share falls with the square of the delay: once to stay stable, and
once because an old reading says little of what is missing now."""

HIGHEST_CORRECTION: Final = 0.1
"""Largest correction up and down, as a share of the plant's rating."""

ERROR_MEMORY_S: Final = 20.0
"""Time constant of the mean error of the plant's power [s]."""


class Response(NamedTuple):
    """How a plant's inverters follow commands, as its scenario states.

    delay_s: Longest time until a command takes effect [s].
    ramp_kw_per_s: Fastest change of all of them together [kW/s].
    """

    delay_s: float = 0.0
    ramp_kw_per_s: float = inf


def corrected(
    correction_kw: float,
    missing_kw: float,
    is_free: bool,
    rating_kw: float,
    cycle_s: float,
    delay_s: float,
) -> float:
    """Return the correction that the central controller adds to its target [kW].

    Parameters
    ----------
    correction_kw
        The last correction.
    missing_kw
        What the meter lacks of what it should show, from `missing_kw`.
    is_free
        Whether no inverter is curtailed. Then nothing can be added.
    rating_kw
        Rating of the plant.
    cycle_s
        Time between two corrections [s]. A controller that acts in every m-th cycle corrects in
        that cycle, by the means over the intervals since its last correction.
    delay_s
        Time that messages need to the inverters and back [s], in addition to the cycle that a
        setpoint holds.
    """
    if is_free:
        return 0.0
    gain = min(GAIN_PER_S * cycle_s, HIGHEST_GAIN / (1.0 + delay_s / cycle_s) ** 2)
    most_kw = HIGHEST_CORRECTION * rating_kw
    return min(max(correction_kw + gain * missing_kw, -most_kw), most_kw)


def follows_kw(last_kw: float, aim_kw: float, cycle_s: float, response: Response) -> float:
    """Return how far the inverters have followed a new aim after a cycle, by their ramp [kW]."""
    most_kw = response.ramp_kw_per_s * cycle_s
    return min(max(aim_kw, last_kw - most_kw), last_kw + most_kw)


def shown_turns(delay_s: float, turn_s: float, response: Response) -> int:
    """Return of how many turns, the last one included, the meter may still show the aims.

    One more while inverters are on a ramp, which the light and their own targets delay.
    """
    is_slow = response.ramp_kw_per_s < inf
    # A quotient of whole cycles is whole: 3 cycles of 0.1 s divide to 3.0000000000000004.
    return 1 + ceil(round(delay_s / turn_s, 6)) + is_slow


def missing_kw(expected_kw: Sequence[float], metered_kw: float) -> float:
    """Return what the meter lacks of what it should show; negative if it shows more [kW].

    It may show any power between those expected in the intervals within the inverters' delay:
    against the newest alone, the correction would add up what is only on its way, and overshoot.
    """
    return min(max(metered_kw, min(expected_kw)), max(expected_kw)) - metered_kw


def mean_error_kw(error_kw: float, missing_kw: float, is_free: bool, cycle_s: float) -> float:
    """Return the mean distance between what the plant aimed at and its meter [kW].

    With no inverter curtailed the sky decides, and the last mean holds.
    """
    if is_free:
        return error_kw
    gain = cycle_s / (ERROR_MEMORY_S + cycle_s)
    return error_kw + (abs(missing_kw) - error_kw) * gain
