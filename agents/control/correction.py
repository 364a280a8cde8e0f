"""The integral correction: moves the target by what the plant's meter shows to be wrong.

Its reading shows the effect of all errors: of estimates, delays and losses.
"""

from __future__ import annotations

from math import inf
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
    wanted_kw: float,
    metered_kw: float,
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
    wanted_kw, metered_kw
        What the plant aimed at, without the correction, and its meter reading, both for the
        interval that ended.
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
    return min(max(correction_kw + gain * (wanted_kw - metered_kw), -most_kw), most_kw)


def expected_kw(last_kw: float, aim_kw: float, cycle_s: float, response: Response) -> float:
    """Return what the meter should show at the end of a cycle while inverters follow a new aim.

    Errors are measured against this. Against the aim itself, the correction would add up what is
    only on its way, and overshoot.
    """
    if response == Response():
        return aim_kw
    step_kw = (aim_kw - last_kw) * cycle_s / (cycle_s + response.delay_s)
    most_kw = response.ramp_kw_per_s * cycle_s
    return last_kw + min(max(step_kw, -most_kw), most_kw)


def mean_error_kw(
    error_kw: float, wanted_kw: float, metered_kw: float, is_free: bool, cycle_s: float
) -> float:
    """Return the mean distance between what the plant aimed at and its meter [kW].

    With no inverter curtailed the sky decides, and the last mean holds.
    """
    if is_free:
        return error_kw
    gain = cycle_s / (ERROR_MEMORY_S + cycle_s)
    return error_kw + (abs(wanted_kw - metered_kw) - error_kw) * gain
