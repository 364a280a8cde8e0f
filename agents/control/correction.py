"""The integral correction: adds to the target the power that the plant's meter shows to be missing.

Its reading shows the effect of all errors: of estimates, delays and losses.
"""

from __future__ import annotations

from typing import Final

GAIN_PER_S: Final = 0.5
"""Share of what is missing that is added in a second."""

HIGHEST_GAIN: Final = 0.7
"""Share of it that is added at once, at most. Where a reading comes a cycle late, 1 would swing.

If it comes later still, the share falls with the square of the delay: once to stay stable, and
once because an old reading says little of what is missing now."""

HIGHEST_CORRECTION: Final = 0.1
"""Largest correction, as a share of the plant's rating."""


def corrected(
    correction_kw: float,
    dispatch_kw: float,
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
    dispatch_kw, metered_kw
        Dispatch, without the correction, and its meter reading, both for the
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
    return min(
        max(correction_kw + gain * (dispatch_kw - metered_kw), 0.0), HIGHEST_CORRECTION * rating_kw
    )
