"""Step 1: estimate the maximum power that an inverter could give (IMPP)."""

from __future__ import annotations

from math import isfinite
from typing import Final, NamedTuple

METER_TOLERANCE: Final = 0.05
"""Share of the rating by which a meter may read more than the rating before that is absurd."""


class Estimate(NamedTuple):
    """What a direct controller knows of its inverter's maximum.

    Attributes
    ----------
    power_kw
        The IMPP: what it tells its parent.
    stale_cycles
        How many cycles ago the maximum was last measured.
    measured_kw
        The maximum as it was last measured; while it is hidden, what is assumed of it.
    expected_kw
        What was expected of the next measurement. Its error teaches how far to trust the next.
    spread_kw
        Mean error of what was expected.
    meter_error
        Mean of what the meter read above the limit that held the inverter, as a share of it.
    below_limit
        By what share of the limit the last reading lay below it; 0 without a limit.
    reads_low
        By what share of a limit readings lie below it although it holds the inverter.
    """

    power_kw: float
    stale_cycles: int
    measured_kw: float = 0.0
    expected_kw: float = 0.0
    spread_kw: float = 0.0
    meter_error: float = 0.0
    below_limit: float = 0.0
    reads_low: float = 0.0


def estimate_impp(
    power_kw: float | None, alpha: float | None, rating_kw: float, last: Estimate
) -> Estimate:
    """Estimate the maximum power from measured power and the alpha applied with it (eq. 1).

    A measurement that is missing or absurd keeps the last estimate and makes it one cycle older:
    power that is NaN, negative or above the rating by more than the meter's error; alpha outside
    (0, 1].

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
    if power_kw is None or alpha is None or not is_plausible(power_kw, alpha, rating_kw):
        return Estimate(last.power_kw, last.stale_cycles + 1)
    return Estimate(min(power_kw / alpha, rating_kw), 0)


def is_plausible(power_kw: float, alpha: float, rating_kw: float) -> bool:
    """Whether an inverter of this rating can have measured this power under this alpha."""
    # NaN fails every comparison, so it is refused here without a test of its own.
    highest_kw = rating_kw * (1.0 + METER_TOLERANCE)
    return isfinite(power_kw) and 0.0 <= power_kw <= highest_kw and 0.0 < alpha <= 1.0

NOTHING_KNOWN = Estimate(0.0, 1, meter_error=0.002)
ImppEstimate = Estimate
_old = estimate_impp
def estimate_impp(p,a,av,r,last): return _old(p,a,r,last)
