"""What the sun's path says of measured irradiance: the moment of a time stamp, and mistakes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import pandas as pd

from bus_schemas.errors import listed
from sim_plant import Floats, imported_when_used

if TYPE_CHECKING:
    from sim_plant.irradiance import Irradiance

pvlib = imported_when_used("pvlib")

_TURBIDITY: Final = 3.0
_BRIGHT_WM2: Final = 100.0
_MOST: Final = 10_000
"""Values that are looked at: of longer files every second one, or fewer."""

_CLEARLY: Final = 0.02
"""Share of the energy above a clear sky by which one zone fits better than another."""

_EDGES_S: Final = 300.0
_STUCK_VALUES: Final = 20
_STUCK_MIN: Final = 10.0
_OFFSETS: Final[dict[Literal["begin", "middle", "end"], float]] = {
    "begin": 0.5,
    "middle": 0.0,
    "end": -0.5,
}
"""From the stamp to the middle of its interval, in steps."""


def clear_ghi(times: pd.DatetimeIndex, coordinates: pd.DataFrame) -> Floats:
    """Return the GHI of a clear sky over the middle of some stations [W/m^2], shape (T,)."""
    lat, lon = coordinates.mean()
    site = pvlib.location.Location(lat, lon)
    sky = site.get_clearsky(times, model="ineichen", linke_turbidity=_TURBIDITY)
    return np.asarray(sky["ghi"].to_numpy(), dtype=np.float64)


def stamps_by_sun(
    ghi_wm2: pd.Series, coordinates: pd.DataFrame, step: pd.Timedelta
) -> tuple[Literal["begin", "middle", "end"], str]:
    """Guess which moment of its interval a time stamp names, and say why.

    Under a clear sky the measured share of the clear-sky irradiance hardly changes over a day; with
    a wrong moment it falls or rises all day. What clouds leave open counts as the begin.
    """
    times = pd.DatetimeIndex(ghi_wm2.index)[:20_000]
    measured = ghi_wm2.to_numpy()[: len(times)]
    spread = {}
    for stamps, steps in _OFFSETS.items():
        clear = clear_ghi(times + steps * step, coordinates)
        bright = (clear > _BRIGHT_WM2) & np.isfinite(measured)
        share = measured[bright] / clear[bright]
        spread[stamps] = (
            float(share.std() / share.mean()) if share.size > 3 and share.any() else 1.0
        )
    first, second, _ = sorted(spread, key=lambda one: spread[one])
    if spread[first] < 0.1 and spread[second] > 1.3 * spread[first]:
        return first, "by the sun's path (irradiance.stamps)"
    return "begin", "which the file does not say (irradiance.stamps)"


def zone_by_sun(
    naive: pd.DatetimeIndex, ghi_wm2: Floats, coordinates: pd.DataFrame
) -> tuple[str, bool]:
    """Guess the zone of time stamps without an offset; tell whether one fits better than others.

    If none does, it is UTC or the standard time of the place.
    """
    local = round(float(coordinates["lon"].mean()) / 15.0)
    part = slice(None, None, len(naive) // _MOST + 1)
    excess = {
        hours: _excess(ghi_wm2[part], clear_ghi(naive[part].tz_localize(_zone(hours)), coordinates))
        for hours in {0, local, max(local - 1, -12), local + 1}
    }
    first, second = sorted(excess, key=excess.__getitem__)[:2]
    if excess[first] < excess[second] - _CLEARLY:
        return _zone(first), True
    return _zone(0 if excess[0] < excess[local] - _CLEARLY else local), False


def _zone(hours: int) -> str:
    return f"Etc/GMT{-hours:+d}" if hours else "UTC"  # POSIX counts west as positive.


def _excess(ghi_wm2: Floats, clear_wm2: Floats) -> float:
    """Return the share of the energy that lies above a clear sky."""
    above = np.nansum(np.maximum(ghi_wm2 - 1.2 * clear_wm2, 0.0))
    return float(above / max(np.nansum(ghi_wm2), 1.0))


def doubts_of(irradiance: Irradiance) -> tuple[str, ...]:
    """Say what in measured irradiance is probably a mistake, and what it looks like."""
    ghi_wm2 = irradiance.ghi_wm2.iloc[:: len(irradiance.ghi_wm2) // _MOST + 1]
    return (*_of_the_sun(ghi_wm2.mean(axis=1), irradiance.coordinates), *_of_sensors(ghi_wm2))


def _of_the_sun(mean_wm2: pd.Series, coordinates: pd.DataFrame) -> Iterator[str]:
    times, measured = pd.DatetimeIndex(mean_wm2.index), mean_wm2.to_numpy()
    clear = clear_ghi(times, coordinates)
    above = measured > 1.3 * clear + 50.0
    above_s = float(above.sum()) * step_s(times)
    off_h = hours_from_noon(mean_wm2, coordinates)
    # Short bright edges of clouds are right, and a cloudy noon moves the brightest hour a little.
    is_doubtful = above_s > _EDGES_S and above.sum() > 0.05 * (measured > _BRIGHT_WM2).sum()
    if not is_doubtful and not (abs(off_h) > 4.0 and np.ptp(clear) > 300.0):
        return
    swapped = coordinates.set_axis(["lon", "lat"], axis=1)[["lat", "lon"]]
    is_swapped = swapped["lat"].abs().max() <= 90.0 and (
        _excess(measured, clear_ghi(times, swapped)) < 0.2 * _excess(measured, clear)
    )
    looks = "are these local times?" if abs(off_h) > 2.0 else "is the unit W/m2?"
    if is_swapped and abs(hours_from_noon(mean_wm2, swapped)) < 2.0:
        looks = "are latitude and longitude swapped?"
    yield (
        f"irradiance is above 1.3 times a clear sky for {above_s / 60.0:,.0f} min, and the "
        f"brightest hour is {abs(off_h):.1f} h from solar noon: {looks}"
    )


def hours_from_noon(mean_wm2: pd.Series, coordinates: pd.DataFrame) -> float:
    """Return how far the middle of the brightest hour is from solar noon [h], from -12 to 12."""
    brightest = brightest_hour(mean_wm2)
    # Solar time, whose equation of time matters less than a zone: within 17 min.
    hour = (brightest.hour + brightest.minute / 60.0 + float(coordinates["lon"].mean()) / 15.0) % 24
    return float((hour - 12.0 + 12.0) % 24.0 - 12.0)


def brightest_hour(mean_wm2: pd.Series) -> pd.Timestamp:
    """Return the middle of the brightest hour, in UTC."""
    steps = max(round(3600.0 / step_s(pd.DatetimeIndex(mean_wm2.index))), 1)
    hourly = mean_wm2.rolling(min(steps, len(mean_wm2)), center=True, min_periods=1).mean()
    return pd.DatetimeIndex(hourly.index)[int(hourly.argmax())].tz_convert("UTC")


def step_s(times: pd.DatetimeIndex) -> float:
    return float(np.median(np.diff(times.asi8))) / 1e9


def _of_sensors(ghi_wm2: pd.DataFrame) -> Iterator[str]:
    values, names = ghi_wm2.to_numpy(), list(map(str, ghi_wm2.columns))
    step_min = step_s(pd.DatetimeIndex(ghi_wm2.index)) / 60.0
    means = values.mean(axis=0)
    for at, name in enumerate(names):
        others = np.delete(means, at)
        usual = float(np.median(others)) if others.size else 0.0
        if usual > 20.0 and means[at] < 0.02 * usual:
            yield f"{name} shows {means[at]:.1f} W/m2 on average, the others {usual:.0f}: dead?"
        elif usual > 20.0 and means[at] < 0.6 * usual:
            share = 100.0 * means[at] / usual
            yield f"{name} has {share:.0f} % of the others' irradiance: shaded, or another unit?"
        longest, value = _longest_run(values[:, at])
        if longest >= _STUCK_VALUES and longest * step_min >= _STUCK_MIN and value > 50.0:
            yield f"{name} shows {value:g} W/m2 for {longest * step_min:.0f} min: stuck?"
    alike: dict[bytes, list[str]] = {}
    for at, name in enumerate(names):
        if np.ptp(values[:, at]) > 1.0:
            alike.setdefault(values[:, at].tobytes(), []).append(name)
    for group in alike.values():
        if len(group) > 1:
            yield f"{listed(group)} are equal throughout: one sensor twice?"


def _longest_run(values: Floats) -> tuple[int, float]:
    """Return how many equal values follow each other at most, by day, and that value."""
    changes = np.flatnonzero(np.diff(values) != 0.0) + 1
    begins = np.concatenate([[0], changes])
    lengths = np.diff(np.append(begins, len(values))) * (values[begins] > 50.0)
    longest = int(lengths.argmax())
    return int(lengths[longest]), float(values[begins[longest]])
