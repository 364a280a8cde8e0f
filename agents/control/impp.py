"""Step 1: from an inverter's power to its maximum (IMPP); the last step: from it to alpha."""

from __future__ import annotations

from typing import Final, NamedTuple

from bus_schemas.bounds import METER_TOLERANCE

FIRST_METER_ERROR: Final = 0.008
"""Assumed error of an inverter's meter before anything is known of it, as a share."""

ROUNDING: Final = 1e-9
"""Requests within this share of the IMPP count as full power."""


class Meter(NamedTuple):
    """What a direct controller has learned of what its inverter says.

    Attributes
    ----------
    reads
        What it reads while a limit holds it, as a share of that limit.
    error
        Mean deviation of such a reading from this, as a share of the limit.
    stated_share
        How much of its stated available power it gave when no limit held it.
    """

    reads: float = 1.0
    error: float = FIRST_METER_ERROR
    stated_share: float = 1.0


class Estimate(NamedTuple):
    """What a direct controller knows of its inverter's maximum.

    Attributes
    ----------
    power_kw
        The IMPP, which it reports to its parent. Its error teaches how far to trust the next.
    stale_cycles
        Cycles since the last usable measurement. A limit that hides the maximum is no fault of the
        measurement: it does not count.
    is_seen
        Whether the last measurement showed the maximum, and no limit hid it.
    is_stated
        Whether the maximum is what the inverter states of it, so that no limit hides it.
    maximum_kw
        The maximum as it was last measured; while it is hidden, what is assumed.
    trend_kw_per_s
        How fast it rises or falls, smoothed.
    spread_kw
        Error of the IMPP as a forecast, as a root mean square.
    followed_kw2, trends_kw2
        How well changes followed the trends before them: the fading sums of change times trend,
        and of the trend squared, each in kW a cycle.
    """

    power_kw: float
    stale_cycles: int
    is_seen: bool = False
    is_stated: bool = False
    maximum_kw: float = 0.0
    trend_kw_per_s: float = 0.0
    spread_kw: float = 0.0
    followed_kw2: float = 0.0
    trends_kw2: float = 0.0
    meter: Meter = Meter()


NOTHING_KNOWN: Final = Estimate(0.0, 0)
"""The estimate before the first measurement."""


def estimate_impp(
    power_kw: float, alpha: float, available_kw: float, rating_kw: float, last: Estimate
) -> Estimate:
    """Estimate the maximum power from the measured power and the alpha applied with it (eq. 1).

    A curtailed inverter that states its available power is believed. A measurement that is missing
    or absurd keeps the last estimate and makes it one cycle older.

    Parameters
    ----------
    power_kw
        Power measured in the interval that just ended; NaN if there is none.
    alpha
        Curtailment level that the inverter applied in it, in (0, 1].
    available_kw
        Available power that the inverter states; NaN if it states none.
    rating_kw
        AC rating; the estimate never exceeds it.
    last
        The estimate of the cycle before.
    """
    if not is_plausible(power_kw, alpha, rating_kw):
        return stale(last)
    maximum_kw = min(max(power_kw, 0.0) / alpha, rating_kw)  # A tripped one draws standby power.
    if alpha < 1.0 and is_stated(available_kw, rating_kw):
        maximum_kw = min(available_kw, rating_kw)
    return Estimate(maximum_kw, 0, True, False, maximum_kw, 0.0, 0.0, 0.0, 0.0, last.meter)


def is_plausible(power_kw: float, alpha: float, rating_kw: float) -> bool:
    """Whether an inverter of this rating can have measured this power under this alpha."""
    # NaN fails every comparison: it needs no test of its own.
    lowest_kw, highest_kw = -METER_TOLERANCE * rating_kw, rating_kw * (1.0 + METER_TOLERANCE)
    return lowest_kw <= power_kw <= highest_kw and 0.0 < alpha <= 1.0


def is_lost(last: Estimate, hold_cycles: int) -> bool:
    """Whether measurements have failed for so long that the inverter is not counted on."""
    return last.stale_cycles > hold_cycles


def is_stated(available_kw: float, rating_kw: float) -> bool:
    """Whether an inverter states its available power, and one that its rating allows."""
    return 0.0 <= available_kw <= rating_kw * (1.0 + METER_TOLERANCE)


def stale(last: Estimate) -> Estimate:
    """Return an estimate that is one cycle older: there was no usable measurement."""
    return Estimate(
        power_kw=last.power_kw,
        stale_cycles=last.stale_cycles + 1,
        is_seen=False,
        is_stated=last.is_stated,
        maximum_kw=last.maximum_kw,
        trend_kw_per_s=last.trend_kw_per_s,
        spread_kw=last.spread_kw,
        followed_kw2=last.followed_kw2,
        trends_kw2=last.trends_kw2,
        meter=last.meter,
    )


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
