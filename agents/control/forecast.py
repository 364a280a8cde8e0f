"""Step 1, ahead of the paper: the IMPP as a forecast of the interval that is about to begin.

The paper's IMPP is the maximum of the interval that just ended. A cloud's edge moves on meanwhile,
and what it takes in one cycle is the shortfall that the paper's rule causes. Three things mend it,
all of them within the direct controller:

* the maximum is extrapolated along its last change (damped trend: Gardner and McKenzie, Management
  Science 31 (1985), doi:10.1287/mnsc.31.10.1237);
* of that forecast its own mean error is taken off in part, so that a sky that changes is trusted
  less than one that does not. In place of the symmetric error of a best estimate there is then a
  little more delivered than asked for, and much less missing (newsvendor rule);
* where the inverter holds a power limit below its maximum, the maximum cannot be measured. Unless
  the inverter states what it could give, it is then assumed to grow from the last value that was
  seen, so that the inverter is asked for more and more until it shows what it has: a slow probe,
  as in extremum seeking. Whether the limit or a cloud holds an inverter is told by its own meter,
  whose error is learned.
"""

from __future__ import annotations

from typing import Final

from agents.control.impp import Estimate, is_plausible, is_stated, measured_maximum_kw, stale

DAMPING: Final = 0.9
"""Share of the last change that is expected to go on."""

TREND_TIME_S: Final = 0.0

MARGIN: Final = 0.4
"""Share of the mean forecast error that is taken off the forecast."""

ERROR_MEMORY_S: Final = 20.0
"""Time constant of the mean forecast error [s]."""

BOUND_TOLERANCE: Final = 0.02
"""Nearer to its limit than this share of it, an inverter counts as held by the limit."""

BOUND_SPREADS: Final = 10.0
"""So does one that is nearer than so many times what its meter read above its limits on the mean.
What lies above a limit can only be the meter's error, while below it a cloud may be. Of normal
errors that is 4 standard deviations."""

WIDEST_BOUND_TOLERANCE: Final = 0.25
"""However bad the meter, what is further from its limit is not held by it."""

METER_MEMORY_S: Final = 100.0
"""Time constant of the meter's mean error [s]."""

LOW_READING: Final = 0.08
RELEASE_JUMP: Final = 1.1
LOW_READING_SAFETY: Final = 1.5
LOW_READING_MEMORY_S: Final = 3600.0

HIDDEN_GROWTH_PER_S: Final = 0.01
"""Share by which a hidden maximum is assumed to grow in a second. Without growth a rising sun is
not seen, until all inverters are believed to lack power and are let free at once."""

HIDDEN_ALPHA_MIN: Final = 1e-3
"""Lowest curtailment level where a limit hides the maximum in any case: there is nothing to keep
observable, and 5 % of an assumed maximum would be too much in the first light."""


def forecast_impp(
    power_kw: float,
    alpha: float,
    available_kw: float,
    limit_kw: float,
    rating_kw: float,
    cycle_s: float,
    last: Estimate,
) -> Estimate:
    """Forecast the maximum power of the interval that is about to begin.

    Parameters
    ----------
    power_kw
        Power measured in the interval that just ended; NaN if there is none.
    alpha
        Share of its maximum that the inverter gave in it, in (0, 1]. An inverter that only holds a
        limit gave 1.
    available_kw
        Available power that the inverter states; NaN if it states none.
    limit_kw
        Power that it did not exceed, whatever its maximum; the rating or more if it was free.
    rating_kw
        AC rating; the forecast never exceeds it.
    cycle_s
        Length of a cycle [s].
    last
        The forecast of the cycle before.

    Returns
    -------
    Estimate
        With a measurement that is missing or absurd the last forecast, one cycle older.
    """
    if not is_plausible(power_kw, alpha, rating_kw):
        return stale(last)
    maximum_kw = measured_maximum_kw(power_kw, alpha, available_kw, rating_kw)
    reads_low = last.reads_low / (1.0 + cycle_s / LOW_READING_MEMORY_S)
    if 0.0 < last.below_limit <= LOW_READING and maximum_kw > RELEASE_JUMP * last.maximum_kw:
        reads_low = max(reads_low, LOW_READING_SAFETY * last.below_limit)
    is_held = limit_kw < rating_kw and power_kw >= limit_kw * (1.0 - _tolerance(last, reads_low))
    if not is_held:
        below = 1.0 - power_kw / limit_kw if 0.0 < limit_kw < rating_kw else 0.0
        return _seen(maximum_kw, last.meter_error, below, reads_low, rating_kw, cycle_s, last)
    meter_error = last.meter_error
    if limit_kw > 0.0:
        above = max(power_kw / limit_kw - 1.0, 0.0)
        meter_error += (above - meter_error) * _gain(cycle_s, METER_MEMORY_S)
    if is_stated(available_kw, rating_kw):
        maximum_kw = min(available_kw, rating_kw)
        return _seen(maximum_kw, meter_error, 0.0, reads_low, rating_kw, cycle_s, last)
    growth = 1.0 + HIDDEN_GROWTH_PER_S * cycle_s
    assumed_kw = min(max(last.maximum_kw, limit_kw) * growth, rating_kw)
    return Estimate(
        power_kw=assumed_kw,
        stale_cycles=0,
        is_seen=False,
        maximum_kw=assumed_kw,
        expected_kw=assumed_kw,
        spread_kw=last.spread_kw,
        meter_error=meter_error,
        below_limit=0.0,
        reads_low=reads_low,
    )


def _seen(
    maximum_kw: float,
    meter_error: float,
    below: float,
    reads_low: float,
    rating_kw: float,
    cycle_s: float,
    last: Estimate,
) -> Estimate:
    """Extrapolate a maximum that was measured or stated."""
    change_kw, spread_kw = 0.0, last.spread_kw
    if last.is_seen:
        change_kw = maximum_kw - last.maximum_kw
        error_kw = abs(maximum_kw - last.expected_kw)
        spread_kw += (error_kw - spread_kw) * _gain(cycle_s, ERROR_MEMORY_S)
    expected_kw = min(max(maximum_kw + DAMPING * change_kw, 0.0), rating_kw)
    return Estimate(
        power_kw=max(expected_kw - MARGIN * spread_kw, 0.0),
        stale_cycles=0,
        is_seen=True,
        maximum_kw=maximum_kw,
        expected_kw=expected_kw,
        spread_kw=spread_kw,
        meter_error=meter_error,
        below_limit=below,
        reads_low=reads_low,
    )


def _tolerance(last: Estimate, reads_low: float) -> float:
    """How far below its limit, as a share of it, an inverter that it holds may read."""
    widest = max(BOUND_TOLERANCE, BOUND_SPREADS * last.meter_error, reads_low)
    return min(widest, WIDEST_BOUND_TOLERANCE)


def _gain(cycle_s: float, time_constant_s: float) -> float:
    """Weight of one cycle in a mean with this time constant."""
    return cycle_s / (time_constant_s + cycle_s)
