"""What a sky does to a plant, in numbers: the same for a measured and for a synthetic one.

Everything here is a function of the clear-sky index at N sensors and T equidistant times, an array
of shape (T, N), and of where the sensors stand. Three questions are asked of it.

1. How alike are two sensors? `pair_correlations` of the index or of its changes, by distance, along
   and across the motion of the clouds. With a lag between the two sensors the correlation is the
   greatest when the cloud has gone from one to the other: `cloud_motion` reads speed and direction
   from that.
2. How fast does it change? `changes` within some seconds, and how often they exceed a given size:
   `exceedance`.
3. What kind of sky is it? `sky_shares`: cloudy, partly cloudy, clear, enhanced; `cloud_cover`.

The first two are the statistics by which Lohmann et al. describe the pyranometer network that one
of the project's measured skies is from (doi:10.5194/acp-16-6365-2016).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import fft

from sim_plant import Floats

CLEAR_FROM = 0.9

# Kinds of sky, and the clear-sky index at which each begins.
_KINDS = {"cloudy": -np.inf, "partly": 0.5, "clear": CLEAR_FROM, "enhanced": 1.05}

# A pair stands along the motion if it lies within so many degrees of it, across if of its normal.
_SECTOR_DEG = 30.0

# A lower peak of the cross-correlation may be two clouds that look alike, not one seen twice.
_LEAST_PEAK = 0.5

_LONGEST_LAG_S = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class PairCorrelations:
    """Pearson's r of each of the P = N (N - 1) / 2 pairs of sensors; NaN where one never changes.

    `east_m` and `north_m` lead from the first sensor of the pair to the second.
    """

    east_m: Floats
    north_m: Floats
    correlation: Floats

    @property
    def distance_m(self) -> Floats:
        """Distance of each pair."""
        return np.asarray(np.hypot(self.east_m, self.north_m))

    def within(self, towards_deg: float) -> "PairCorrelations":
        """Return the pairs that lie along a direction (clockwise from north), or its opposite."""
        along_m, _ = rotated(self.east_m, self.north_m, towards_deg)
        kept = np.abs(along_m) >= self.distance_m * np.cos(np.deg2rad(_SECTOR_DEG))
        return PairCorrelations(self.east_m[kept], self.north_m[kept], self.correlation[kept])

    def by_distance(self, limits_m: Floats) -> Floats:
        """Return the mean correlation in each class of distance, NaN for a class without a pair."""
        which = np.digitize(self.distance_m, limits_m) - 1
        valid = np.isfinite(self.correlation) & (which >= 0) & (which < limits_m.size - 1)
        count = np.bincount(which[valid], minlength=limits_m.size - 1)
        total = np.bincount(which[valid], self.correlation[valid], minlength=limits_m.size - 1)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class PeakLags:
    """When each pair of sensors is most alike.

    `lag_s` says how much later the second sensor sees what the first one saw; NaN where the peak
    lies beyond the longest lag. `correlation` is Pearson's r at that lag.
    """

    east_m: Floats
    north_m: Floats
    lag_s: Floats
    correlation: Floats


@dataclass(frozen=True, slots=True)
class CloudMotion:
    """How the pattern of clouds moves; `from_deg` is where they come from, clockwise from north."""

    speed_ms: float
    from_deg: float


def changes(index: Floats, step_s: float, interval_s: float) -> Floats:
    """Return the changes within an interval, at every time at which one begins."""
    steps = round(interval_s / step_s)
    return np.asarray(index[steps:] - index[:-steps])


def exceedance(change: Floats, thresholds: Floats) -> Floats:
    """Return the share of changes that are larger than each threshold in either direction."""
    size = np.sort(np.abs(change), axis=None)
    return 1.0 - np.searchsorted(size, thresholds, side="right") / size.size


def sky_shares(index: Floats) -> dict[str, float]:
    """Return the shares of cloudy, partly cloudy, clear and enhanced time, which add up to 1."""
    count, _ = np.histogram(index, bins=[*_KINDS.values(), np.inf])
    return dict(zip(_KINDS, (count / index.size).tolist(), strict=True))


def cloud_cover(index: Floats) -> float:
    """Return the share of the time in which a cloud is before the sun: an index below 0.9."""
    return float(np.mean(index < CLEAR_FROM))


def index_by_quantile(power: Floats, quantile: float = 0.95) -> Floats:
    """Stand in for the clear-sky index where there is no clear sky to divide by.

    Each sensor's values are divided by a high quantile of its own. That is near 1 in the sun if the
    sensor was in the sun for more than the rest, and takes out what differs from sensor to sensor
    (calibration, tilt, dirt). It does not follow the sun: for an hour, not for a day.
    """
    return np.asarray(power / np.quantile(power, quantile, axis=0))


def rotated(east_m: Floats, north_m: Floats, towards_deg: float) -> tuple[Floats, Floats]:
    """Return the coordinates along a direction, clockwise from north, and to the left of it."""
    towards = np.deg2rad(towards_deg)
    along_m = east_m * np.sin(towards) + north_m * np.cos(towards)
    return along_m, north_m * np.sin(towards) - east_m * np.cos(towards)


def pair_correlations(series: Floats, east_m: Floats, north_m: Floats) -> PairCorrelations:
    """Correlate each sensor with each other one at the same time."""
    first, second = np.triu_indices(series.shape[1], k=1)
    normal = _standardised(series)
    return PairCorrelations(
        east_m[second] - east_m[first],
        north_m[second] - north_m[first],
        np.asarray((normal.T @ normal / len(normal))[first, second]),
    )


def lagged_correlations(
    series: Floats, first: NDArray[np.intp], second: NDArray[np.intp], most_steps: int
) -> Floats:
    """Correlate sensors with later and earlier values of other sensors.

    Row `most_steps + m` correlates the first sensor of each pair with the second one `m` steps
    later.
    """
    length = len(series)
    spectrum = fft.rfft(_standardised(series), fft.next_fast_len(2 * length), axis=0)
    lags = np.arange(-most_steps, most_steps + 1)
    correlation = np.empty((lags.size, first.size))
    for pair, (i, j) in enumerate(zip(first, second, strict=True)):
        product = fft.irfft(spectrum[:, i].conj() * spectrum[:, j], fft.next_fast_len(2 * length))
        correlation[:, pair] = product[lags]
    # The fewer values overlap, the smaller is the sum: divide by their number.
    return np.asarray(correlation / (length - np.abs(lags))[:, None])


def peak_lags(index: Floats, east_m: Floats, north_m: Floats, step_s: float) -> PeakLags:
    """Find for each pair of sensors the lag at which their 30 s changes are most alike.

    The longest lag is 300 s, or a quarter of the series.
    """
    change = changes(index, step_s, 30.0)
    first, second = np.triu_indices(index.shape[1], k=1)
    most_steps = int(min(_LONGEST_LAG_S / step_s, len(change) / 4))
    lag_s, peak = _peaks(lagged_correlations(change, first, second, most_steps), step_s)
    return PeakLags(east_m[second] - east_m[first], north_m[second] - north_m[first], lag_s, peak)


def cloud_motion(index: Floats, east_m: Floats, north_m: Floats, step_s: float) -> CloudMotion:
    """Read the motion of the clouds from the lags at which sensors are most alike.

    A pattern that moves with velocity v without changing, and is alike in all directions, is most
    alike at two sensors at a distance d with the lag d . s, where s = v / |v|^2 is the slowness.
    The slowness is fitted by least squares to the lags of all pairs, weighted by the square of
    their peak correlation: first to the quarter of the pairs that is most alike, then again to all
    that are off by at most three robust standard deviations, or one step. Where the clouds change
    while they move, the speed comes out too high.
    """
    found = peak_lags(index, east_m, north_m, step_s)
    apart_m = np.stack([found.east_m, found.north_m], axis=1)
    alike = np.isfinite(found.lag_s) & (found.correlation >= _LEAST_PEAK)
    # The quarter that is most alike comes first, for among the rest some peaks are chance.
    kept = alike & (
        found.correlation >= np.sort(found.correlation[alike])[-max(3, alike.sum() // 4)]
    )
    for _ in range(10):
        weight = found.correlation[kept]
        slowness, *_ = np.linalg.lstsq(apart_m[kept] * weight[:, None], found.lag_s[kept] * weight)
        off_s = np.abs(found.lag_s - apart_m @ slowness)
        spread_s = 1.4826 * float(np.median(off_s[kept]))
        kept = alike & (off_s <= max(3.0 * spread_s, step_s))
    from_deg = float(np.rad2deg(np.arctan2(-slowness[0], -slowness[1]))) % 360.0
    return CloudMotion(1.0 / float(np.hypot(*slowness)), from_deg)


def _peaks(correlation: Floats, step_s: float) -> tuple[Floats, Floats]:
    """Lag [s] and height of each pair's peak, between steps by a parabola; NaN at the margin."""
    rows = np.argmax(np.nan_to_num(correlation, nan=-1.0), axis=0)
    inside = (rows > 0) & (rows < len(correlation) - 1)
    rows = np.where(inside, rows, 1)
    pairs = np.arange(correlation.shape[1])
    before, top, after = (correlation[rows + shift, pairs] for shift in (-1, 0, 1))
    bend = before - 2.0 * top + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    lag_s = (rows + shift - len(correlation) // 2) * step_s
    return np.where(inside, lag_s, np.nan), top


def _standardised(series: Floats) -> Floats:
    centred = series - series.mean(axis=0)
    spread = centred.std(axis=0)
    return np.asarray(centred / np.where(spread > 0.0, spread, np.nan))


def real_plant(folder: Path, hour: str) -> tuple[Floats, Floats, Floats, Floats]:
    """Read an hour of a real plant: currents, shape (T, combiners), and where the combiners stand.

    The last array averages over the combiners of each inverter.
    """
    currents = pd.read_csv(folder / f"hour_{hour}.csv", index_col="t_s").dropna(axis="columns")
    places = pd.read_csv(folder / "positions.csv", dtype=str).set_index("combiner")
    places = places.loc[currents.columns]
    east_m, north_m = places[["x_m", "y_m"]].to_numpy(dtype=np.float64).T
    inverters = places["inverter"].to_numpy()
    averaging = (inverters[:, None] == np.unique(inverters)).astype(np.float64)
    return currents.to_numpy(dtype=np.float64), east_m, north_m, averaging / averaging.sum(axis=0)
