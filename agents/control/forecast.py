"""Step 1, ahead of the paper: the IMPP as a forecast of the interval that is about to begin.

The paper's IMPP is the maximum of the interval that just ended. A cloud's edge moves on meanwhile,
and what it takes in one cycle is the shortfall that the paper's rule causes. Three things mend it,
all of them within the direct controller:

* the maximum is extrapolated along its last change (damped trend: Gardner and McKenzie, Management
  Science 31 (1985), doi:10.1287/mnsc.31.10.1237);
* of that forecast its own mean error is taken off in part, so that a sky that changes is trusted
  less than one that does not. In place of the symmetric error of a best estimate there is then a
  little more delivered than asked for, and much less missing (newsvendor rule);
* where the inverter holds a power limit below its maximum, the maximum cannot be measured. It is
  then assumed to grow from the last value that was seen, so that the inverter is asked for more
  and more until it shows what it has: a slow probe, as in extremum seeking. Whether the limit or
  a cloud holds an inverter is told by its own meter, whose error is learned.
"""

from __future__ import annotations

from typing import Final

from agents.control.impp import ImppEstimate, is_plausible

DAMPING: Final = 0.9
"""Share of the last change that is expected to go on. Of 0.5, 0.8, 0.9 and 1 the latter two were
best on 1 s and 10 s measurements; 0.9 overshoots less."""

MARGIN: Final = 0.4
"""Share of the mean forecast error that is taken off the forecast."""

ERROR_MEMORY_CYCLES: Final = 20.0
"""Time constant of the mean forecast error."""

BOUND_TOLERANCE: Final = 0.02
"""Nearer to its limit than this share of it, an inverter counts as held by the limit."""

BOUND_SPREADS: Final = 10.0
"""So does one that is nearer than so many times what its meter read above its limits on the mean.
What lies above a limit can only be the meter's error, while below it a cloud may be. Of normal
errors that is 4 standard deviations. A reading that only seems to lie below the limit would make
all that is known of the maximum forgotten."""

WIDEST_BOUND_TOLERANCE: Final = 0.25
"""However bad the meter, what is further from its limit is not held by it."""

METER_MEMORY_CYCLES: Final = 100.0
"""Time constant of the meter's mean error."""

LOW_READING: Final = 0.08
"""Up to this share a meter may read below the limit that holds its inverter, without a cloud."""

RELEASE_JUMP: Final = 1.1
"""A reading below the limit was the meter's, or the inverter's own, if the inverter gives so many
times as much once it is free."""

LOW_READING_SAFETY: Final = 1.5
"""So many times as far below the limit as that, a reading is then taken for held by it."""

LOW_READING_MEMORY_CYCLES: Final = 3600.0
"""Time constant after which that is forgotten."""

FIRST_METER_ERROR: Final = 0.002
"""What is taken for it before anything is known."""

HIDDEN_GROWTH: Final = 0.01
"""Share by which a hidden maximum is assumed to grow in a cycle. Without growth a rising sun is not
seen, until all inverters are believed to lack power and are let free at once."""

HIDDEN_ALPHA_MIN: Final = 1e-3
"""Lowest curtailment level where a limit hides the maximum in any case: there is nothing to keep
observable, and 5 % of an assumed maximum would be too much in the first light."""


NOTHING_KNOWN: Final = ImppEstimate(0.0, 1, meter_error=FIRST_METER_ERROR)
"""The estimate before the first measurement."""


def forecast_impp(
    power_kw: float | None,
    alpha: float | None,
    limit_kw: float,
    rating_kw: float,
    last: ImppEstimate,
) -> ImppEstimate:
    """Forecast the maximum power of the interval that is about to begin.

    Parameters
    ----------
    power_kw
        Power measured in the interval that just ended, None if there is none.
    alpha
        Share of its maximum that the inverter gave in it.
    limit_kw
        Power that it did not exceed, whatever its maximum; the rating or more if it was free.
    rating_kw
        AC rating; the forecast never exceeds it.
    last
        The forecast of the cycle before.

    Returns
    -------
    ImppEstimate
        With a measurement that is missing or absurd the last forecast, one cycle older.
    """
    if power_kw is None or alpha is None or not is_plausible(power_kw, alpha, rating_kw):
        return last._replace(stale_cycles=last.stale_cycles + 1)
    measured_kw = min(power_kw / alpha, rating_kw)
    last = _with_low_reading(measured_kw, last)
    if limit_kw < rating_kw and power_kw >= limit_kw * (1.0 - _tolerance(last)):
        return _hidden(power_kw, limit_kw, rating_kw, last)
    return _seen(measured_kw, power_kw, limit_kw, rating_kw, last)


def _seen(
    measured_kw: float, power_kw: float, limit_kw: float, rating_kw: float, last: ImppEstimate
) -> ImppEstimate:
    """Extrapolate a maximum that was measured."""
    change_kw, spread_kw = 0.0, last.spread_kw
    if last.stale_cycles == 0:
        change_kw = measured_kw - last.measured_kw
        error_kw = abs(measured_kw - last.expected_kw)
        spread_kw += (error_kw - spread_kw) / ERROR_MEMORY_CYCLES
    expected_kw = min(max(measured_kw + DAMPING * change_kw, 0.0), rating_kw)
    return last._replace(
        power_kw=max(expected_kw - MARGIN * spread_kw, 0.0),
        stale_cycles=0,
        measured_kw=measured_kw,
        expected_kw=expected_kw,
        spread_kw=spread_kw,
        below_limit=1.0 - power_kw / limit_kw if 0.0 < limit_kw < rating_kw else 0.0,
    )


def _hidden(power_kw: float, limit_kw: float, rating_kw: float, last: ImppEstimate) -> ImppEstimate:
    """Assume a maximum behind a limit."""
    assumed_kw = min(max(last.measured_kw, limit_kw) * (1.0 + HIDDEN_GROWTH), rating_kw)
    meter_error = last.meter_error
    if limit_kw > 0.0:
        above = max(power_kw / limit_kw - 1.0, 0.0)
        meter_error += (above - meter_error) / METER_MEMORY_CYCLES
    return last._replace(
        power_kw=assumed_kw,
        stale_cycles=last.stale_cycles + 1,
        measured_kw=assumed_kw,
        expected_kw=assumed_kw,
        meter_error=meter_error,
        below_limit=0.0,
    )


def _tolerance(last: ImppEstimate) -> float:
    """How far below its limit, as a share of it, an inverter that it holds may read."""
    widest = max(BOUND_TOLERANCE, BOUND_SPREADS * last.meter_error, last.reads_low)
    return min(widest, WIDEST_BOUND_TOLERANCE)


def _with_low_reading(measured_kw: float, last: ImppEstimate) -> ImppEstimate:
    """Learn from an inverter that had far more than it seemed to have below its limit."""
    reads_low = last.reads_low * (1.0 - 1.0 / LOW_READING_MEMORY_CYCLES)
    if 0.0 < last.below_limit <= LOW_READING and measured_kw > RELEASE_JUMP * last.measured_kw:
        reads_low = max(reads_low, LOW_READING_SAFETY * last.below_limit)
    return last._replace(reads_low=reads_low)

_oldf = forecast_impp
def forecast_impp(p,a,av,l,r,c,last): return _oldf(p,a,l,r,last)
