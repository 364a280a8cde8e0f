"""Step 1: estimate the maximum power that an inverter could give (IMPP)."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple


class ImppEstimate(NamedTuple):
    """An inverter's estimated maximum power [kW], and how many cycles ago it was measured."""

    power_kw: float
    stale_cycles: int


def estimate_impp(
    power_kw: float | None, alpha: float | None, rating_kw: float, last: ImppEstimate
) -> ImppEstimate:
    """Estimate the maximum power from measured power and the alpha applied with it (eq. 1).

    A measurement that is missing or absurd keeps the last estimate and makes it one cycle older:
    power that is NaN, negative or above the rating; alpha outside (0, 1].

    Parameters
    ----------
    power_kw
        Power measured in the interval that just ended, None if there is none.
    alpha
        Curtailment level that the inverter applied in it.
    rating_kw
        AC rating; the estimate never exceeds it.
    last
        The estimate of the cycle before.

    Returns
    -------
    ImppEstimate
        `power_kw / alpha`, at most the rating.
    """
    if power_kw is None or alpha is None or not _plausible(power_kw, alpha, rating_kw):
        return ImppEstimate(last.power_kw, last.stale_cycles + 1)
    return ImppEstimate(min(power_kw / alpha, rating_kw), 0)


def _plausible(power_kw: float, alpha: float, rating_kw: float) -> bool:
    # NaN fails every comparison, so it is refused here without a test of its own.
    return isfinite(power_kw) and 0.0 <= power_kw <= rating_kw and 0.0 < alpha <= 1.0
