"""The last step of a cycle: from the power an inverter must give to its curtailment level alpha."""

from __future__ import annotations

from typing import Final

ROUNDING: Final = 1e-9
"""An inverter that is asked for all it has but this share of it is asked for all."""


def curtailment_level(setpoint_kw: float, impp_kw: float, alpha_min: float) -> float:
    """Return alpha = setpoint / IMPP (eq. 6), within [alpha_min, 1].

    Alpha never reaches zero because the next IMPP is measured through it: P / alpha. An inverter
    without power (IMPP = 0) is free, alpha = 1, so that its first kilowatt is seen. An alpha within
    `ROUNDING` of 1 is 1: a free inverter gives all it has, and whether one is free must not depend
    on the last bit of a sum.

    Parameters
    ----------
    setpoint_kw
        Power that the inverter must give, not negative.
    impp_kw
        Its estimated maximum power, not negative.
    alpha_min
        Lowest alpha that keeps the IMPP observable, in (0, 1].
    """
    if setpoint_kw >= impp_kw * (1.0 - ROUNDING):
        return 1.0
    return min(max(setpoint_kw / impp_kw, alpha_min), 1.0)
