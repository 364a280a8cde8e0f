"""The tables of docs/clouds.md, and its figures: measured skies beside those of the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sky_statistics import (
    changes,
    cloud_cover,
    cloud_motion,
    exceedance,
    index_by_quantile,
    pair_correlations,
    peak_lags,
    real_plant,
    rotated,
    sky_shares,
)
from tables import DOCUMENTS, Lines, Tables, header, row

from sim_plant.clouds import CloudSettings, clear_sky_ghi, clear_sky_index
from sim_plant.irradiance import read_measured_ghi

mpl.use("Agg")

Array = NDArray[np.float64]

SKIES_DRAWN = 12
MOST_SEEDS = 300
COVER_TOLERANCE = 0.1
HOPE_MINUTES, HOPE_BLIND = "0915_0955", "0955_1015"
MEASURED, SYNTHETIC = "#b2182b", "#2166ac"
CLASSES_M = np.array([0.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0, 500.0, 700.0, 1000.0, 1500.0])
# Two skies that are not the default's kind: sharp and fast clouds, and thin ones.
OF_ANOTHER_KIND = {
    "Livermore": {"drift_speed_ms": 20.0, "cloud_softness": 0.6, "thick_cloud_index": 0.3},
    "plant, hour b": {"thick_cloud_index": 0.75},
}
SIZES = np.geomspace(0.003, 1.0, 120)
LEVELS = np.arange(0.0, 1.55, 0.05)


@dataclass(frozen=True)
class Sky:
    """A measured sky, and how the model is asked for its like."""

    name: str
    index: Array
    step_s: float
    # Where the model is read [m], and how what is read there is averaged into the sensors.
    east_m: Array
    north_m: Array
    averaging: Array
    by_quantile: bool
    speed_ms: float | None
    from_deg: float | None
    # Settings beyond speed, direction and cover: empty in all comparisons but two.
    by_hand: dict[str, float] = field(default_factory=dict)

    @property
    def sensor_east_m(self) -> Array:
        """East of each sensor [m]."""
        return np.asarray(self.east_m @ self.averaging)

    @property
    def sensor_north_m(self) -> Array:
        """North of each sensor [m]."""
        return np.asarray(self.north_m @ self.averaging)

    def settings(self) -> CloudSettings:
        """Speed, direction and cover as the measurement has them; all else by default."""
        motion = {"drift_speed_ms": self.speed_ms, "drift_from_deg": self.from_deg}
        known = {name: value for name, value in motion.items() if value is not None}
        return CloudSettings(**{"cloud_cover": cloud_cover(self.index)} | known | self.by_hand)

    def synthetic(self, settings: CloudSettings, seed: int) -> Array:
        """Draw the model's index, averaged and normalised as the measurement is."""
        time_s = np.arange(len(self.index), dtype=np.float64) * self.step_s
        drawn = clear_sky_index(time_s, self.east_m, self.north_m, settings, seed)
        return index_by_quantile(drawn @ self.averaging) if self.by_quantile else drawn

    def alike(self) -> tuple[list[Array], int]:
        """Skies of the model that are about as cloudy, and how many seeds were looked at."""
        found: list[Array] = []
        for seed in range(1, MOST_SEEDS + 1):
            drawn = self.synthetic(self.settings(), seed)
            if abs(cloud_cover(drawn) - cloud_cover(self.index)) <= COVER_TOLERANCE:
                found.append(drawn)
            if len(found) == SKIES_DRAWN:
                break
        return found, seed


def measured_skies(folder: Path) -> Iterator[Sky]:
    """Read the data sets."""
    yield _hope(folder / "hope-melpitz-1s")
    yield _livermore(folder / "livermore-ghi-2s")
    for hour in "abc":
        yield _plant(folder / "plant20mw-combiners-10s", hour)


def blind_skies(folder: Path) -> Iterator[Sky]:
    """Read what nobody saw while the model was made; nothing where files are missing."""
    hope, plant = folder / "hope-melpitz-1s", folder / "plant20mw-combiners-10s"
    if (hope / f"ghi_20130908_{HOPE_BLIND}.csv").exists():
        yield replace(_hope(hope, HOPE_BLIND), name="HOPE, next 20 min")
    for hour in "de":
        if (plant / f"hour_{hour}.csv").exists():
            yield _plant(plant, hour)


def _hope(folder: Path, minutes: str = HOPE_MINUTES) -> Sky:
    read = read_measured_ghi(folder / f"ghi_20130908_{minutes}.csv", folder / "positions.csv")
    places = pd.read_csv(folder / "positions.csv", dtype={"station": str}).set_index("station")
    places = places.loc[list(read.sensors)]
    east_m, north_m = places["x_m"].to_numpy(float), places["y_m"].to_numpy(float)
    index = index_by_quantile(read.ghi_wm2)
    motion = cloud_motion(index, east_m, north_m, 1.0)
    one_each = np.eye(east_m.size)
    speed_ms, from_deg = motion.speed_ms, motion.from_deg
    return Sky("HOPE", index, 1.0, east_m, north_m, one_each, True, speed_ms, from_deg)


def _livermore(folder: Path) -> Sky:
    """Read the cloudy morning, 8 to 12 h; turbidity 2.5 makes the cloudless afternoon 1."""
    table = pd.read_csv(folder / "ghi_20140518.csv")
    table = table[(table["t_s"] >= 8 * 3600) & (table["t_s"] < 12 * 3600)]
    midnight = pd.Timestamp("2014-05-18T00:00-08:00")
    times = pd.DatetimeIndex(midnight + pd.to_timedelta(table["t_s"], unit="s"))
    clear_wm2 = clear_sky_ghi(times, np.array([37.676208]), np.array([-121.703118]), 200.0, 2.5)
    index = (table["ghi_wm2"].to_numpy(float) / clear_wm2)[:, None]
    place = np.zeros(1)
    return Sky("Livermore", index, 2.0, place, place, np.eye(1), False, None, None)


def _plant(folder: Path, hour: str) -> Sky:
    """Read an hour of the 20 MW plant: the mean of each inverter's combiner currents."""
    currents, east_m, north_m, averaging = real_plant(folder, hour)
    index = index_by_quantile(currents @ averaging)
    motion = cloud_motion(index, east_m @ averaging, north_m @ averaging, 10.0)
    speed_ms, from_deg = motion.speed_ms, motion.from_deg
    name = f"plant, hour {hour}"
    return Sky(name, index, 10.0, east_m, north_m, averaging, True, speed_ms, from_deg)


def by_distance(sky: Sky, index: Array, direction: str, interval_s: float | None) -> Array:
    """Correlation by classes of distance: of the index, or of its changes within an interval."""
    series = index if interval_s is None else changes(index, sky.step_s, interval_s)
    pairs = pair_correlations(series, sky.sensor_east_m, sky.sensor_north_m)
    towards_deg = (sky.from_deg or 0.0) + 180.0
    if direction == "along":
        pairs = pairs.within(towards_deg)
    elif direction == "across":
        pairs = pairs.within(towards_deg + 90.0)
    return pairs.by_distance(CLASSES_M)


def panels_of(rows: int, skies: list[Sky], height: float, **shared: Any) -> tuple[Figure, Any]:
    """Make a column of panels for each sky."""
    size = (9.5, height)
    return plt.subplots(rows, len(skies), figsize=size, sharex=True, layout="constrained", **shared)


def band(
    axes: Axes, x: Array, curves: list[Array], color: str, label: str, style: str = "-"
) -> None:
    """Draw the median of curves and the range of the middle eight tenths."""
    there = np.isfinite(curves).all(axis=0)
    low, middle, high = np.quantile(np.array(curves)[:, there], [0.1, 0.5, 0.9], axis=0)
    axes.fill_between(x[there], low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(x[there], middle, style, color=color, linewidth=1.2, label=label)


def draw_correlation(skies: list[Sky], drawn: dict[str, list[Array]]) -> Figure:
    """Draw the correlation of sensors against their distance."""
    figure, panels = panels_of(3, skies, 7.4, sharey=True)
    middle_m = 0.5 * (CLASSES_M[1:] + CLASSES_M[:-1])
    rows = [
        ("any", None, "index"),
        ("along", 30.0, "30 s changes,\nalong the motion"),
        ("across", 30.0, "30 s changes,\nacross the motion"),
    ]
    for column, sky in enumerate(skies):
        for at, (direction, interval_s, title) in enumerate(rows):
            axes = panels[at, column]
            curves = [by_distance(sky, index, direction, interval_s) for index in drawn[sky.name]]
            band(axes, middle_m, curves, SYNTHETIC, "synthetic")
            real = by_distance(sky, sky.index, direction, interval_s)
            there = np.isfinite(real)
            axes.plot(middle_m[there], real[there], "o-", color=MEASURED, ms=3, label="measured")
            axes.axhline(0.0, color="gray", linewidth=0.5)
            if column == 0:
                axes.set_ylabel(f"correlation of\n{title}")
        panels[0, column].set_title(sky.name)
        panels[-1, column].set_xlabel("distance [m]")
    panels[0, 0].set_ylim(-0.45, 1.02)
    legend(figure, panels[0, 0])
    return figure


def travelled(sky: Sky, index: Array) -> tuple[Array, Array, Array]:
    """Distance along the motion, lag and correlation of the pairs that stand one behind other."""
    found = peak_lags(index, sky.sensor_east_m, sky.sensor_north_m, sky.step_s)
    along_m, across_m = rotated(found.east_m, found.north_m, (sky.from_deg or 0.0) + 180.0)
    kept = (np.abs(across_m) < 60.0) & np.isfinite(found.lag_s)
    forward = np.where(along_m < 0.0, -1.0, 1.0)
    return (along_m * forward)[kept], (found.lag_s * forward)[kept], found.correlation[kept]


def draw_lags(skies: list[Sky], drawn: dict[str, list[Array]]) -> Figure:
    """Draw how much later, and how much alike, a sensor down wind sees the same clouds."""
    figure, panels = panels_of(2, skies, 5.2, sharey="row")
    for column, sky in enumerate(skies):
        upper, lower = panels[:, column]
        samples = (
            (travelled(sky, drawn[sky.name][0]), SYNTHETIC, "synthetic (one sky)"),
            (travelled(sky, sky.index), MEASURED, "measured"),
        )
        for (along_m, lag_s, correlation), color, label in samples:
            upper.plot(along_m, lag_s, ".", color=color, markersize=3, label=label)
            lower.plot(along_m, correlation, ".", color=color, markersize=3)
        reach_m = np.array([0.0, 1400.0])
        upper.plot(reach_m, reach_m / (sky.speed_ms or np.nan), "k-", lw=0.8, label="fitted speed")
        upper.set_title(f"{sky.name}\n{sky.speed_ms:.1f} m/s from {sky.from_deg:.0f}°")
        lower.set_xlabel("distance along [m]")
    panels[0, 0].set(ylabel="lag of the peak [s]", ylim=(-20, 260), xlim=(0, 1400))
    panels[1, 0].set(ylabel="correlation at the peak", ylim=(0, 1.02))
    legend(figure, panels[0, 0])
    return figure


def draw_changes(skies: list[Sky], drawn: dict[str, list[Array]]) -> Figure:
    """Draw how often the index changes by more than a given size."""
    figure, panels = panels_of(1, skies, 3.4, sharey=True)
    styles = ((0, "-"), (1, "--"))
    for axes, sky in zip(panels, skies, strict=True):
        for (which, style), interval_s in zip(styles, intervals_s(sky), strict=False):
            curves = [
                exceedance(changes(index, sky.step_s, interval_s), SIZES)
                for index in drawn[sky.name]
            ]
            name = f"{interval_s:g} s"
            band(axes, SIZES, curves, SYNTHETIC, f"synthetic, {name}", style)
            real = exceedance(changes(sky.index, sky.step_s, interval_s), SIZES)
            label = f"measured, {name}"
            axes.plot(SIZES, real, style, color=MEASURED, lw=1.2 + 0.2 * which, label=label)
        axes.set(xscale="log", yscale="log", xlim=(0.003, 1.0), ylim=(1e-4, 1.0), title=sky.name)
        axes.set_xlabel("change of the index")
        axes.set_xticks([0.01, 0.1, 1.0], ["0.01", "0.1", "1"])
        axes.legend(fontsize=6, frameon=False, loc="lower left")
    panels[0].set_ylabel("share of changes that are larger")
    return figure


def draw_shares(skies: list[Sky], drawn: dict[str, list[Array]]) -> Figure:
    """Draw the histogram of the clear-sky index."""
    figure, panels = panels_of(1, skies, 3.0)
    middle = 0.5 * (LEVELS[1:] + LEVELS[:-1])
    for axes, sky in zip(panels, skies, strict=True):
        curves = [histogram(index) for index in drawn[sky.name]]
        band(axes, middle, curves, SYNTHETIC, "synthetic")
        axes.step(middle, histogram(sky.index), where="mid", color=MEASURED, label="measured")
        axes.set(title=sky.name, xlabel="clear-sky index", xlim=(0.1, 1.5))
        axes.set_ylim(bottom=0.0)
        axes.set_xticks([0.5, 1.0, 1.5])
    panels[0].set_ylabel("density")
    legend(figure, panels[0])
    return figure


def histogram(index: Array) -> Array:
    """Density of the index over LEVELS."""
    return np.histogram(index, LEVELS, density=True)[0]


def intervals_s(sky: Sky) -> tuple[float, ...]:
    """Return the step and 10 s, or 10 and 30 s where the step is 10 s."""
    return (10.0, 30.0) if sky.step_s == 10.0 else (sky.step_s, 10.0)


def legend(figure: Figure, axes: Axes) -> None:
    """One legend for all panels, below them."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)


def numbers(sky: Sky, index: Array) -> dict[str, float]:
    """Return the key figures of a sky."""
    found = {
        **{f"share {kind}": share for kind, share in sky_shares(index).items()},
        "index, 5 % quantile": float(np.quantile(index, 0.05)),
        "index, median": float(np.median(index)),
    }
    for interval_s in (sky.step_s, 10.0, 30.0, 60.0):
        size = np.abs(changes(index, sky.step_s, interval_s))
        found[f"{interval_s:g} s change, 99 %"] = float(np.quantile(size, 0.99))
        found[f"{interval_s:g} s change, 99.9 %"] = float(np.quantile(size, 0.999))
    if index.shape[1] > 1:
        of_index = by_distance(sky, index, "any", None)
        of_changes = {each_s: by_distance(sky, index, "any", each_s) for each_s in (30.0, 60.0)}
        for low, number in ((150, 3), (300, 5), (500, 7), (700, 8), (1000, 9)):
            if np.isfinite(of_index[number]):
                limits = f"{low}-{CLASSES_M[number + 1]:.0f} m"
                found[f"r of index, {limits}"] = float(of_index[number])
                for interval_s, correlation in of_changes.items():
                    found[f"r of {interval_s:g} s changes, {limits}"] = float(correlation[number])
    return found


Comparison = tuple[Sky, dict[str, float], list[dict[str, float]], int]


def comparison(sky: Sky, drawn: list[Array], seeds: int) -> Comparison:
    """Return a sky with its figures, those of the model's skies, and the seeds looked at."""
    return sky, numbers(sky, sky.index), [numbers(sky, index) for index in drawn], seeds


@cache
def compared(folder: Path) -> dict[str, Comparison]:
    """Compare each sky; their pictures are drawn on the way."""
    found, drawn = {}, {}
    skies = list(measured_skies(folder))
    for sky in skies:
        drawn[sky.name], seeds = sky.alike()
        found[sky.name] = comparison(sky, drawn[sky.name], seeds)
    fields = [sky for sky in skies if sky.speed_ms is not None]
    figures = {
        "clouds_correlation": draw_correlation(fields, drawn),
        "clouds_lags": draw_lags(fields, drawn),
        "clouds_changes": draw_changes(skies, drawn),
        "clouds_index": draw_shares(skies, drawn),
    }
    for name, figure in figures.items():
        figure.savefig(DOCUMENTS / "images" / f"{name}.png", dpi=110)
    return found


def skies_seen(folder: Path) -> Lines:
    """Write the skies that were seen while the model was made, beside those of the model."""
    names = ("HOPE", "plant, hour a", "plant, hour b", "plant, hour c")
    yield from side_by_side([compared(folder)[name] for name in names])


def skies_unseen(folder: Path) -> Lines:
    """Write the skies that were not."""
    found = []
    for sky in blind_skies(folder):
        found.append(comparison(sky, *sky.alike()))
    if found:
        yield from side_by_side(found)


def side_by_side(found: list[Comparison]) -> Lines:
    """Write measured skies beside the model's, with their median and middle 80 %."""
    names = [sky.name for sky, *_ in found]
    yield from header(["measured / synthetic (10 % to 90 %)", *names])
    settings = [sky.settings() for sky, *_ in found]
    covers = (f"{one.cloud_cover:.2f}, {one.drift_speed_ms:.1f} m/s" for one in settings)
    yield row(["cover, speed", *covers])
    yield row(["skies, of so many seeds", *(f"{len(rows)} of {n}" for _, _, rows, n in found)])
    for figure in found[0][1] | found[-1][1]:
        cells = []
        for _, real, rows, _ in found:
            if figure not in real:
                cells.append("")
                continue
            low, middle, high = np.quantile([one[figure] for one in rows], [0.1, 0.5, 0.9])
            first, *others = (written(figure, value) for value in (real[figure], middle, low, high))
            cells.append("{} / {} ({} to {})".format(first, *others))
        yield row([figure, *cells])


def written(figure: str, value: float) -> str:
    """Return a figure as it stands in a table."""
    return f"{value:.{3 if 'change, ' in figure else 2}f}"


def another_kind(folder: Path) -> Lines:
    """Write the two skies of another kind by default and with settings chosen by hand."""
    yield from header(["", "measured", "by default", "by hand"])
    for name, by_hand in OF_ANOTHER_KIND.items():
        sky, real, rows, _ = compared(folder)[name]
        changed = replace(sky, by_hand=by_hand)
        reached = comparison(changed, *changed.alike())[2]
        for figure, value in real.items():
            if figure.startswith("r of") or "99.9" in figure:
                continue
            medians = [float(np.median([one[figure] for one in of])) for of in (rows, reached)]
            cells = [written(figure, one) for one in (value, *medians)]
            yield row([f"{name}: {figure}", *cells])


TABLES: Final[Tables] = {
    "skies": skies_seen,
    "blind skies": skies_unseen,
    "another kind": another_kind,
}
