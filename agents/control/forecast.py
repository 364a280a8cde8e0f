"""Step 1, ahead of the paper: the IMPP as a forecast of the interval that is about to begin.

The paper's IMPP is the maximum of the interval that just ended, so a moving cloud edge causes a
shortfall. The direct controller reduces it in three ways:

* the maximum is extrapolated along its last change (damped trend: Gardner and McKenzie, Management
  Science 31 (1985), doi:10.1287/mnsc.31.10.1237);
* an inverter that holds a power limit and is asked for all it has is not set free, but held a
  little above its forecast. A free inverter gives whatever the sky gives, and over-delivers when a
  cloud leaves;
* where the inverter holds a power limit below its maximum, the maximum cannot be measured. Unless
  the inverter states what it could give, it is then assumed to grow from the last value that was
  seen: a slow probe, as in extremum seeking. The inverter's own meter, whose error is learned,
  shows whether the limit or a cloud holds it.
"""

from __future__ import annotations

from typing import Final

from agents.control.impp import (
    ROUNDING,
    Estimate,
    Meter,
    is_plausible,
    is_stated,
    stale,
)

DAMPING: Final = 0.8
"""Share of the trend that is expected to go on. At equal over-delivery 0.8 to 1 miss about as
little on measurements of 1 s and 10 s; 0.8 overshoots least."""

TREND_TIME_S: Final = 0.5
"""Time constant of the trend [s]: in short cycles the last change alone is mostly noise."""

HELD_SPREADS: Final = 1.0
"""An inverter that is asked for all it has is held this many mean forecast errors above its
forecast, ..."""

HELD_SHARE: Final = 0.005
"""... and this share of its rating more. So a limit that hides the maximum always leaves room in
which the maximum shows: at dawn and after a trip forecast and error are 0."""

ERROR_MEMORY_S: Final = 20.0
"""Time constant of the mean forecast error [s]."""

HIDDEN_GROWTH_PER_S: Final = 0.01
"""Share by which a hidden maximum is assumed to grow in a second. Without growth a rising sun is
not seen until all inverters seem to lack power and are released at once."""

HIDDEN_ALPHA_MIN: Final = 1e-3
"""Lowest curtailment level where a limit hides the maximum in any case: there is nothing to keep
observable, and 5 % of an assumed maximum would be too much in the first light."""

BOUND_TOLERANCE: Final = 0.005
"""Nearer to its limit than this share of it, an inverter counts as held by the limit: so exactly
inverters hold theirs."""

BOUND_SPREADS: Final = 10.0
"""An inverter also counts as held if it is nearer than this many times its mean reading above its
limits. What lies above a limit can only be the meter's error, while below it a cloud may be. Of
normal errors that is 4 standard deviations."""

METER_MEMORY_S: Final = 100.0
"""Time constant of that mean [s]."""

METER_READINGS: Final = 30.0
"""Least number of readings for that mean: fewer say too little about a noisy meter."""

WIDEST_BOUND_TOLERANCE: Final = 0.05
"""An inverter that is further from its limit is not held by it, however bad its meter."""

STATED_MEMORY_S: Final = 20.0
"""Time constant with which the bias of a stated available power is learned [s], from readings that
no limit holds down."""

LEAST_STATED_SHARE: Final = 0.5
MOST_STATED_SHARE: Final = 2.0
"""Bounds of what one such reading may say: near 0 kW it says nothing."""

LOW_READING: Final = 0.03
"""A held inverter may read below its limit by up to this share. The controller learns it from the
power of the released inverter; otherwise an error of 1 % releases all again and again."""

RELEASE_JUMP: Final = 1.03
"""A reading below the limit was wrong if the free inverter then gives so many times as much."""

LOW_READING_SAFETY: Final = 1.5
"""So many times as far below its limit as that reading, an inverter then counts as held."""

LOW_READING_MEMORY_S: Final = 3600.0
"""Time constant after which that is forgotten [s]."""


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
    power_kw, alpha, available_kw, rating_kw, last
        As in `estimate_impp`. An inverter that only holds a limit applied an alpha of 1.
    limit_kw
        Power that it did not exceed, whatever its maximum; the rating or more if it was free.
    cycle_s
        Length of a cycle [s].

    Returns
    -------
    Estimate
        With a measurement that is missing or absurd the last forecast, one cycle older.
    """
    if not is_plausible(power_kw, alpha, rating_kw):
        return stale(last)
    power_kw = max(power_kw, 0.0)
    states = is_stated(available_kw, rating_kw)
    maximum_kw = min(power_kw / alpha, rating_kw)
    low = _reads_low(maximum_kw, cycle_s, last)
    is_held = limit_kw < rating_kw and power_kw >= limit_kw * (
        1.0 - _tolerance(limit_kw, low, last)
    )
    meter = _learned(maximum_kw, available_kw, limit_kw, rating_kw, low, is_held, cycle_s, last)
    if states and (is_held or alpha < 1.0):
        maximum_kw = min(available_kw * meter.stated_share, rating_kw)
    is_seen = states or not is_held
    if not is_seen:
        growth = 1.0 + HIDDEN_GROWTH_PER_S * cycle_s
        maximum_kw = min(max(last.maximum_kw, limit_kw) * growth, rating_kw)
    trend_kw_per_s, spread_kw = 0.0, last.spread_kw
    if is_seen and last.is_seen:
        change_kw_per_s = (maximum_kw - last.maximum_kw) / cycle_s
        trend_kw_per_s = last.trend_kw_per_s
        trend_kw_per_s += (change_kw_per_s - trend_kw_per_s) * _gain(cycle_s, TREND_TIME_S)
        error_kw = abs(maximum_kw - last.power_kw)
        spread_kw += (error_kw - spread_kw) * _gain(cycle_s, ERROR_MEMORY_S)
    return Estimate(
        power_kw=min(max(maximum_kw + DAMPING * trend_kw_per_s * cycle_s, 0.0), rating_kw),
        stale_cycles=0,
        is_seen=is_seen,
        is_stated=states,
        maximum_kw=maximum_kw,
        trend_kw_per_s=trend_kw_per_s,
        spread_kw=spread_kw,
        meter=meter,
    )


def held_kw(setpoint_kw: float, rating_kw: float, known: Estimate) -> float:
    """Return the power limit of an inverter that is asked for all it has, or for more.

    Asked for its forecast, it is held near that; asked for more, since the whole plant lacks
    power, it is free. One that states its available power needs no room in which it would show.
    """
    if setpoint_kw > known.power_kw * (1.0 + ROUNDING):
        return rating_kw
    if known.is_stated and known.power_kw > 0.0:
        return known.power_kw
    room_kw = HELD_SPREADS * known.spread_kw + HELD_SHARE * rating_kw
    return min(known.power_kw + room_kw, rating_kw)


def _tolerance(limit_kw: float, reads_low: float, last: Estimate) -> float:
    """How far below its limit, as a share of it, an inverter that it holds may read.

    An inverter that was asked for all it has is expected just below its limit: there, only a meter
    that is known to read low may take it for held.
    """
    if limit_kw >= last.power_kw * (1.0 - ROUNDING):
        return max(BOUND_TOLERANCE, reads_low)
    widest = max(BOUND_TOLERANCE, BOUND_SPREADS * last.meter.error, reads_low)
    return min(widest, WIDEST_BOUND_TOLERANCE)


def _reads_low(maximum_kw: float, cycle_s: float, last: Estimate) -> float:
    """Learn from an inverter that had far more than it seemed to have below its limit."""
    reads_low = last.meter.reads_low * (1.0 - _gain(cycle_s, LOW_READING_MEMORY_S))
    below = last.meter.below_limit
    if 0.0 < below <= LOW_READING and maximum_kw > RELEASE_JUMP * last.maximum_kw:
        reads_low = max(reads_low, LOW_READING_SAFETY * below)
    return reads_low


def _learned(
    maximum_kw: float,
    stated_kw: float,
    limit_kw: float,
    rating_kw: float,
    reads_low: float,
    is_held: bool,
    cycle_s: float,
    last: Estimate,
) -> Meter:
    """Learn what it reads above its limit, or what it gives of the stated power when free."""
    error, stated_share = last.meter.error, last.meter.stated_share
    above = 0.0
    if 0.0 < limit_kw < rating_kw:
        above = maximum_kw / limit_kw - 1.0
        if is_held:
            gain = min(_gain(cycle_s, METER_MEMORY_S), 1.0 / METER_READINGS)
            error += (max(above, 0.0) - error) * gain
    if not is_held and maximum_kw > 0.0 and 0.0 < stated_kw <= rating_kw:
        share = min(max(maximum_kw / stated_kw, LEAST_STATED_SHARE), MOST_STATED_SHARE)
        stated_share += (share - stated_share) * _gain(cycle_s, STATED_MEMORY_S)
    return Meter(error, 0.0 if is_held else -above, reads_low, stated_share)


def _gain(cycle_s: float, time_constant_s: float) -> float:
    """Weight of the newest value in a mean with this time constant."""
    return cycle_s / (time_constant_s + cycle_s)
