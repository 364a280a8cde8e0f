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
  and more until it shows what it has: a slow probe, as in extremum seeking.
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

HIDDEN_GROWTH: Final = 0.01
"""Share by which a hidden maximum is assumed to grow in a cycle. Without growth a rising sun is not
seen, until all inverters are believed to lack power and are let free at once."""

HIDDEN_ALPHA_MIN: Final = 1e-3
"""Lowest curtailment level where a limit hides the maximum in any case: there is nothing to keep
observable, and 5 % of an assumed maximum would be too much in the first light."""


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
    if limit_kw < rating_kw and power_kw >= limit_kw * (1.0 - BOUND_TOLERANCE):
        return _hidden(limit_kw, rating_kw, last)
    measured_kw = min(power_kw / alpha, rating_kw)
    change_kw, spread_kw = 0.0, last.spread_kw
    if last.stale_cycles == 0:
        change_kw = measured_kw - last.measured_kw
        error_kw = abs(measured_kw - last.expected_kw)
        spread_kw += (error_kw - spread_kw) / ERROR_MEMORY_CYCLES
    expected_kw = min(max(measured_kw + DAMPING * change_kw, 0.0), rating_kw)
    impp_kw = max(expected_kw - MARGIN * spread_kw, 0.0)
    return ImppEstimate(impp_kw, 0, measured_kw, expected_kw, spread_kw)


def _hidden(limit_kw: float, rating_kw: float, last: ImppEstimate) -> ImppEstimate:
    assumed_kw = min(max(last.measured_kw, limit_kw) * (1.0 + HIDDEN_GROWTH), rating_kw)
    return ImppEstimate(assumed_kw, last.stale_cycles + 1, assumed_kw, assumed_kw, last.spread_kw)
