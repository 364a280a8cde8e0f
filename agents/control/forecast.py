"""Step 1, ahead of the paper: the IMPP as a forecast of the interval that is about to begin.

The paper's IMPP is the maximum of the interval that just ended, so a moving cloud edge causes a
shortfall. The direct controller reduces it in three ways:

* the maximum is extrapolated along its last change (damped trend: Gardner and McKenzie, Management
  Science 31 (1985), doi:10.1287/mnsc.31.10.1237). How much of a change goes on is learned: where
  cycles are long beside the clouds, little of it;
* an inverter that holds a power limit and is asked for all it has is not set free, but held a
  little above its forecast. A free inverter gives whatever the sky gives, and over-delivers when a
  cloud leaves;
* where the inverter holds a power limit below its maximum, the maximum cannot be measured. Unless
  the inverter states what it could give, it is then assumed to grow from the last value that was
  seen: a slow probe, as in extremum seeking. The inverter's own meter shows whether the limit or a
  cloud holds it: how it reads a limit is learned.
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from agents.control.impp import (
    ROUNDING,
    Estimate,
    Meter,
    is_plausible,
    is_stated,
    stale,
)

MOST_DAMPING: Final = 0.8
"""Share of the trend that is expected to go on, at most, and before anything is learned. At equal
over-delivery 0.8 to 1 miss about as little on known skies; 0.8 overshoots least."""

DAMPING_MEMORY_S: Final = 600.0
"""Time constant with which that share is learned [s]: some clouds pass in it."""

DAMPING_TREND: Final = 0.1
"""It takes trends of this share of the rating in a cycle to outweigh what was assumed."""

TREND_TIME_S: Final = 0.5
"""Time constant of the trend [s]: in short cycles the last change alone is mostly noise."""

HELD_SPREADS: Final = 0.7
"""An inverter that is asked for all it has is held this many forecast errors, as a root mean
square, above its forecast, ... A few large errors then count for more than many small ones: the
power that returns from a shadow with hard edges needs room for all of it."""

HELD_SHARE: Final = 0.005
"""... and this share of its rating more. So a limit that hides the maximum always leaves room in
which the maximum shows: at dawn and after a trip forecast and error are 0."""

ERROR_MEMORY_S: Final = 20.0
"""Time constant of the mean square of forecast errors [s]."""

SHADOW_SHARE: Final = 0.1
"""An inverter that reads further below what its limit lets it give than this share of its rating
lies in a shadow that was not foreseen. A smaller distance may be the noise of its meter."""

HIDDEN_GROWTH_PER_S: Final = 0.01
"""Share by which a hidden maximum is assumed to grow in a second. Without growth a rising sun is
not seen until all inverters seem to lack power and are released at once."""

HIDDEN_ALPHA_MIN: Final = 1e-3
"""Lowest curtailment level where a limit hides the maximum in any case: there is nothing to keep
observable, and 5 % of an assumed maximum would be too much in the first light."""

BOUND_TOLERANCE: Final = 0.005
"""Nearer to its limit than this share of it, an inverter counts as held by the limit: so exactly
inverters hold theirs."""

BOUND_ERRORS: Final = 5.0
"""One that is asked for less than it has also counts as held if it is nearer than this many times
its meter's mean error. Of normal errors that is 4 standard deviations."""

WIDEST_BOUND_TOLERANCE: Final = 0.1
"""An inverter that is further from its limit is not held by it, however bad its meter. One that
reads so far from what it states is not believed."""

METER_MEMORY_S: Final = 30.0
"""Time constant with which is learned how a meter reads a limit [s]."""

METER_READINGS: Final = 30.0
"""Least number of readings for that: fewer say too little about a noisy meter."""

MOST_LEARNED_ERRORS: Final = 2.0
"""A reading teaches nothing if it is off by more than this number of mean errors: a shadow taken
for the limit must not teach that the meter reads low."""

MOST_BIAS: Final = 0.03
"""A meter is believed to read a limit wrong by this share at most."""

STATED_MEMORY_S: Final = 20.0
"""Time constant with which the bias of a stated available power is learned [s], from readings that
no limit holds down."""

LEAST_STATED_SHARE: Final = 0.5
MOST_STATED_SHARE: Final = 2.0
"""Bounds of what one such reading may say: near 0 kW it says nothing."""


class Reading(NamedTuple):
    """What an inverter says of the interval that ended.

    power_kw: Measured power; NaN if there is none.
    alpha: Curtailment level that it applied, in (0, 1]; 1 if it only holds a limit.
    available_kw: What it states that it could have given; NaN if it states nothing.
    limit_kw: Power that it did not exceed; the rating or more if it was free.
    """

    power_kw: float
    alpha: float
    available_kw: float
    limit_kw: float


class Observed(NamedTuple):
    """The maximum of the interval that ended; assumed, not seen, where a limit hid it.

    is_stated: Whether it is what the inverter states, and that is believed.
    below_kw: How far it lies below what the inverter was expected to give.
    meter: What has been learned of the inverter's meter.
    """

    maximum_kw: float
    is_seen: bool
    is_stated: bool
    below_kw: float
    meter: Meter


def forecast_impp(reading: Reading, rating_kw: float, cycle_s: float, last: Estimate) -> Estimate:
    """Forecast the maximum power of the interval that is about to begin.

    With a measurement that is missing or absurd it is the last forecast, one cycle older.
    """
    if not is_plausible(reading.power_kw, reading.alpha, rating_kw):
        return stale(last)
    return _extrapolated(_observed(reading, rating_kw, cycle_s, last), rating_kw, cycle_s, last)


def _observed(reading: Reading, rating_kw: float, cycle_s: float, last: Estimate) -> Observed:
    """Tell the maximum from a reading, whether a limit hid it, and learn from both."""
    maximum_kw = min(max(reading.power_kw, 0.0) / reading.alpha, rating_kw)
    limit_kw, available_kw, meter = reading.limit_kw, reading.available_kw, last.meter
    asked_for_all = limit_kw >= last.power_kw * (1.0 - ROUNDING)
    believes = False
    if is_stated(available_kw, rating_kw):
        # What the inverter says it could give decides, and not a reading that noise moves.
        stated_kw = min(available_kw * meter.stated_share, rating_kw)
        given_kw = min(stated_kw, limit_kw)
        believes = abs(maximum_kw - given_kw) <= WIDEST_BOUND_TOLERANCE * given_kw
        is_held = believes and limit_kw < rating_kw and limit_kw <= stated_kw
    else:
        lowest_kw = limit_kw * meter.reads * (1.0 - _tolerance(asked_for_all, meter))
        is_held = limit_kw < rating_kw and maximum_kw >= lowest_kw
    if not is_held and maximum_kw > 0.0 and 0.0 < available_kw <= rating_kw:
        meter = _learned_share(maximum_kw / available_kw, cycle_s, meter)
    if is_held and limit_kw > 0.0 and not asked_for_all:
        meter = _learned_reading(maximum_kw / limit_kw, cycle_s, meter)
    if believes:
        maximum_kw = min(available_kw * meter.stated_share, rating_kw)
    elif not is_held:
        maximum_kw = min(maximum_kw / meter.reads, rating_kw)
    else:
        growth = 1.0 + HIDDEN_GROWTH_PER_S * cycle_s
        maximum_kw = min(max(last.maximum_kw, limit_kw) * growth, rating_kw)
    below_kw = min(limit_kw, last.power_kw) - maximum_kw
    return Observed(maximum_kw, believes or not is_held, believes, below_kw, meter)


def _extrapolated(now: Observed, rating_kw: float, cycle_s: float, last: Estimate) -> Estimate:
    """Go on along the trend, as far as trends were seen to go on."""
    trend_kw_per_s, spread_kw = 0.0, last.spread_kw
    error_kw = last.power_kw - now.maximum_kw
    followed_kw2, trends_kw2 = last.followed_kw2, last.trends_kw2
    # A statement after a reading, or the reverse, is no change of the sky.
    if now.is_seen and last.is_seen and now.is_stated == last.is_stated:
        change_kw_per_s = (now.maximum_kw - last.maximum_kw) / cycle_s
        kept, trend_kw = 1.0 - _gain(cycle_s, DAMPING_MEMORY_S), last.trend_kw_per_s * cycle_s
        followed_kw2 = kept * followed_kw2 + change_kw_per_s * cycle_s * trend_kw
        trends_kw2 = kept * trends_kw2 + trend_kw * trend_kw
        trend_kw_per_s = last.trend_kw_per_s
        trend_kw_per_s += (change_kw_per_s - trend_kw_per_s) * _gain(cycle_s, TREND_TIME_S)
        spread_kw = _spread_kw(error_kw, cycle_s, last)
    elif now.is_seen and not last.is_stated and now.below_kw > SHADOW_SHARE * rating_kw:
        spread_kw = _spread_kw(error_kw, cycle_s, last)
    change_kw = _damping(followed_kw2, trends_kw2, rating_kw) * trend_kw_per_s * cycle_s
    return Estimate(
        power_kw=min(_ahead(now.maximum_kw, change_kw), rating_kw),
        stale_cycles=0,
        is_seen=now.is_seen,
        is_stated=now.is_stated,
        maximum_kw=now.maximum_kw,
        trend_kw_per_s=trend_kw_per_s,
        spread_kw=spread_kw,
        followed_kw2=followed_kw2,
        trends_kw2=trends_kw2,
        meter=now.meter,
    )


def held_kw(setpoint_kw: float, rating_kw: float, known: Estimate) -> float:
    """Return the power limit of an inverter that is asked for all it has, or for more.

    Asked for its forecast, it is held near that; asked for more, since the whole plant lacks
    power, it is free. One whose statement is believed needs no room in which its maximum shows.
    """
    if setpoint_kw > known.power_kw * (1.0 + ROUNDING):
        return rating_kw
    if known.is_stated and known.power_kw > 0.0:
        return known.power_kw
    room_kw = HELD_SPREADS * known.spread_kw + HELD_SHARE * rating_kw
    return min(known.power_kw + room_kw, rating_kw)


def _damping(followed_kw2: float, trends_kw2: float, rating_kw: float) -> float:
    """Return the share of a trend that is expected to go on: a regression that fades."""
    assumed_kw2 = (DAMPING_TREND * rating_kw) ** 2
    share = (followed_kw2 + MOST_DAMPING * assumed_kw2) / (trends_kw2 + assumed_kw2)
    return min(max(share, 0.0), MOST_DAMPING)


def _spread_kw(error_kw: float, cycle_s: float, last: Estimate) -> float:
    """Take one more forecast error into their root mean square."""
    apart_kw2 = error_kw * error_kw - last.spread_kw * last.spread_kw
    return sqrt(last.spread_kw * last.spread_kw + apart_kw2 * _gain(cycle_s, ERROR_MEMORY_S))


def _ahead(maximum_kw: float, change_kw: float) -> float:
    """Add a change; a fall takes a share of what is left, so that no error forecasts 0 kW."""
    if change_kw >= 0.0 or maximum_kw <= 0.0:
        return maximum_kw + max(change_kw, 0.0)
    return maximum_kw * maximum_kw / (maximum_kw - change_kw)


def _tolerance(asked_for_all: bool, meter: Meter) -> float:
    """How far below its limit, as a share of it, an inverter that it holds may read.

    An inverter that was asked for all it has is expected just below its limit.
    """
    if asked_for_all:
        return BOUND_TOLERANCE
    return min(max(BOUND_TOLERANCE, BOUND_ERRORS * meter.error), WIDEST_BOUND_TOLERANCE)


def _learned_reading(share: float, cycle_s: float, last: Meter) -> Meter:
    """Learn how the meter reads a limit that holds the inverter far below its maximum."""
    gain = min(_gain(cycle_s, METER_MEMORY_S), 1.0 / METER_READINGS)
    apart = share - last.reads
    error = last.error + (abs(apart) - last.error) * gain
    most = MOST_LEARNED_ERRORS * error
    reads = last.reads + min(max(apart, -most), most) * gain
    return Meter(min(max(reads, 1.0 - MOST_BIAS), 1.0 + MOST_BIAS), error, last.stated_share)


def _learned_share(share: float, cycle_s: float, last: Meter) -> Meter:
    """Learn how much of its stated power the inverter gives while no limit holds it."""
    apart = min(max(share, LEAST_STATED_SHARE), MOST_STATED_SHARE) - last.stated_share
    stated_share = last.stated_share + apart * _gain(cycle_s, STATED_MEMORY_S)
    return Meter(last.reads, last.error, stated_share)


def _gain(cycle_s: float, time_constant_s: float) -> float:
    """Weight of the newest value in a mean with this time constant."""
    return cycle_s / (time_constant_s + cycle_s)
