"""How fast a plant's power rose and fell, and how often faster than a grid code allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True)
class RampMetrics:
    """Ramps of the delivered power P over one minute.

    A ramp is the change over a minute, r(t) = P(t + 60 s) - P(t), taken from every cycle on. What
    rises and falls again within the minute is no ramp. Where 60 s is no multiple of the cycle, it
    is the change over the nearest number of cycles, at least one, as a rate per minute.

    Attributes
    ----------
    largest_up_kw_per_min, largest_down_kw_per_min
        max(0, max r) and max(0, -min r), both in kW per minute and not negative.
    limit_kw_per_min
        What is allowed, either way; None if nothing limits it.
    minutes
        Minutes of the run over which there is a ramp. They follow each other; the last may be cut.
    minutes_above_limit
        Those of them in which a ramp with |r| above the limit began; None without a limit.
    above_limit_percent
        Their share [%]; None without a limit.
    """

    largest_up_kw_per_min: float
    largest_down_kw_per_min: float
    limit_kw_per_min: float | None
    minutes: int
    minutes_above_limit: int | None
    above_limit_percent: float | None

    @property
    def largest_kw_per_min(self) -> float:
        """The larger of the two, in kW per minute."""
        return max(self.largest_up_kw_per_min, self.largest_down_kw_per_min)


def ramp_metrics(
    delivered_kw: NDArray[np.float64],
    rating_kw: float,
    cycle_s: float,
    limit_percent_per_min: float | None = None,
) -> RampMetrics | None:
    """Work out the ramps of a run.

    Parameters
    ----------
    delivered_kw
        Power of the plant, cycle by cycle, shape (T,); NaN where it is not known.
    rating_kw
        AC rating of the plant [kW].
    cycle_s
        Length of a cycle [s].
    limit_percent_per_min
        Ramp limit in % of the rating per minute, if there is one.

    Returns
    -------
    RampMetrics or None
        None if no ramp is known: the run is too short.
    """
    span = max(1, round(60.0 / cycle_s))
    if len(delivered_kw) <= span:
        return None
    ramp_kw_per_min = (delivered_kw[span:] - delivered_kw[:-span]) * (60.0 / (span * cycle_s))
    # By minute the largest ramp; minutes without any known one do not count.
    minute_begins = np.arange(0, len(ramp_kw_per_min), span)
    largest_kw_per_min = np.fmax.reduceat(np.abs(ramp_kw_per_min), minute_begins)
    largest_kw_per_min = largest_kw_per_min[np.isfinite(largest_kw_per_min)]
    if not len(largest_kw_per_min):
        return None
    limit_kw_per_min = above = above_percent = None
    if limit_percent_per_min is not None:
        limit_kw_per_min = rating_kw * limit_percent_per_min / 100.0
        # A plant that ramps exactly as fast as it may is not too fast by a rounding error.
        too_fast = largest_kw_per_min > limit_kw_per_min + _ROUNDING * rating_kw
        above, above_percent = int(too_fast.sum()), 100.0 * float(too_fast.mean())
    return RampMetrics(
        largest_up_kw_per_min=max(0.0, float(np.nanmax(ramp_kw_per_min))),
        largest_down_kw_per_min=max(0.0, -float(np.nanmin(ramp_kw_per_min))),
        limit_kw_per_min=limit_kw_per_min,
        minutes=len(largest_kw_per_min),
        minutes_above_limit=above,
        above_limit_percent=above_percent,
    )
