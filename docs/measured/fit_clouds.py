"""Fits the constants of the cloud model by an optimizer, blind to an hour: `make fit-clouds`.

    python docs/measured/fit_clouds.py DATA

The error of an hour compares its figures with the mean over the model's skies, in units of the
spread of these skies at the shipped constants: one of the model's own skies has an error of 1. It
is the root of the mean square, in which index, changes and correlations count the same.

`make results` reads the fits from their table in the document, and judges them by the skies that
nobody saw while the model was made.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Final
from unittest.mock import patch

import numpy as np
from clouds import (
    COVER_TOLERANCE,
    Array,
    Sky,
    blind_skies,
    measured_skies,
    numbers,
    written,
)
from scipy.optimize import least_squares
from sky_statistics import cloud_cover
from tables import WORKERS, Lines, Tables, header, read_table, row, write_table

from sim_plant import clouds as model
from studies.workers import share_work

# What is fitted: title, shipped value, and the range. A fit begins in the (geometric) middle of the
# range and not at the shipped constants, which know all hours.
CONSTANTS: Final = {
    "_OUTER_SCALE": ("outer scale [cloud sizes]", 14.0, 3.0, 40.0),
    "_SPECTRUM_EXPONENT": ("half the exponent of the spectrum", -1.25, -1.0, -1.7),
    "_STRETCH": ("stretch", 1.5, 0.8, 2.5),
    "_SMOOTHING_M": ("smoothing [m]", 25.0, 10.0, 60.0),
    "_NEIGHBOURHOOD_M": ("how far clouds reflect light [m]", 500.0, 200.0, 1000.0),
    "evolution_s": ("evolution time [s]", 2100.0, 600.0, 6000.0),
    "cloud_softness": ("`cloud_softness`", 1.0, 0.5, 2.0),
    "thick_cloud_index": ("`thick_cloud_index`", 0.4, 0.2, 0.8),
}
SHIPPED: Final = {name: shipped for name, (_, shipped, _, _) in CONSTANTS.items()}
HOURS: Final = ("HOPE", "a", "b", "c")
FITS: Final = ("HOPE a", "HOPE c", "a c", "HOPE a c", "HOPE a b", "HOPE b c", "a b c")
SEEN: Final = (HOURS, *(tuple(names.split()) for names in FITS))
TITLES: Final = ("", "shipped", *(f"fit to {', '.join(names)}" for names in SEEN[1:]))
SHOWN: Final = (
    "60 s change, 99 %",
    "r of 60 s changes, 300-400 m",
    "r of 60 s changes, 500-700 m",
)

# What comes nearer to the skies that nobody had seen: chosen by hand after they were judged.
SOFT: Final = {"cloud_softness": 1.5}
AFTERWARDS: Final = {
    "HOPE, next 20 min": SOFT | {"thick_cloud_index": 0.3},
    "d": SOFT | {"thick_cloud_index": 0.7},
    "e": SOFT | {"thick_cloud_index": 0.2},
}

# All constants see the same skies: fields of these seeds, each read at these times. The error that
# is reported is that of other seeds than those of the fit.
SEEDS_OF_FIT: Final = range(1, 4)
SEEDS_OF_ERROR: Final = range(101, 117)
STARTS_S: Final = 6.0 * 3600.0 * np.arange(6)
STEP: Final = 0.08
MOST_STEPS: Final = 6

Constants = dict[str, float]


@dataclass(frozen=True)
class Drawn:
    """The figures of the model's skies, shape (skies, figures), and how much each sky counts."""

    figures: Array
    weight: Array

    @property
    def mean(self) -> Array:
        """Mean of each figure."""
        return np.asarray(self.weight @ self.figures)

    @property
    def spread(self) -> Array:
        """Standard deviation of each figure."""
        return np.sqrt(self.weight @ (self.figures - self.mean) ** 2)


def hours(folder: Path) -> dict[str, Sky]:
    """Read the hours."""
    found = {sky.name.removeprefix("plant, hour "): sky for sky in measured_skies(folder)}
    found["HOPE"] = every_2_s(found["HOPE"])
    return {name: found[name] for name in HOURS}


def every_2_s(sky: Sky) -> Sky:
    """Halve the work for a sky that was measured every second."""
    return replace(sky, index=sky.index[::2], step_s=2.0) if sky.step_s == 1.0 else sky


def figures(sky: Sky, index: Array) -> dict[str, float]:
    """Return what is compared: the figures of the table of skies, less the shares and 99.9 %."""
    found = numbers(sky, index)
    return {name: found[name] for name in found if "share" not in name and "99.9" not in name}


def draw(skies: dict[str, Sky], constants: Constants, seeds: range) -> dict[str, Drawn]:
    """Draw the model's skies; one counts the more, the nearer its cover is to the measured one."""
    in_module = {name: value for name, value in constants.items() if name.startswith("_")}
    by_hand = {name: value for name, value in constants.items() if name not in in_module}
    rows: dict[str, list[list[float]]] = {name: [] for name in skies}
    off: dict[str, list[float]] = {name: [] for name in skies}
    with patch.multiple(model, **in_module):
        model._layers.cache_clear()
        for seed in seeds:
            for name, sky in skies.items():
                settings = replace(sky, by_hand=by_hand).settings()
                for start_s in STARTS_S:
                    index = sky.synthetic(settings, seed, start_s)
                    rows[name].append(list(figures(sky, index).values()))
                    off[name].append(cloud_cover(index) - cloud_cover(sky.index))
    model._layers.cache_clear()
    weight = {name: np.exp(-0.5 * (np.array(off[name]) / COVER_TOLERANCE) ** 2) for name in skies}
    return {name: Drawn(np.array(rows[name]), weight[name] / weight[name].sum()) for name in skies}


def residuals(sky: Sky, drawn: Drawn, spread: Array) -> Array:
    """Return the deviations, weighted: the sum of their squares is the square of the error."""
    real = figures(sky, sky.index)
    kinds = [
        "correlation" if name.startswith("r of") else "change" if "change" in name else "index"
        for name in real
    ]
    share = np.array([1.0 / (len(set(kinds)) * kinds.count(kind)) for kind in kinds])
    return np.asarray((drawn.mean - list(real.values())) / spread * np.sqrt(share))


def fitted(folder: Path, names: str) -> Constants:
    """Fit the constants to some hours and no others."""
    skies = {name: sky for name, sky in hours(folder).items() if name in names.split()}
    of_shipped = draw(skies, SHIPPED, SEEDS_OF_FIT)

    def constants(place: Iterable[float]) -> Constants:
        """0 is the lowest value of a range, 1 the highest."""
        ranges = [(low, high) for _, _, low, high in CONSTANTS.values()]
        values = [low * (high / low) ** x for (low, high), x in zip(ranges, place, strict=True)]
        return dict(zip(CONSTANTS, map(float, values), strict=True))

    @cache
    def deviations_at(place: tuple[float, ...]) -> Array:
        drawn = draw(skies, constants(place), SEEDS_OF_FIT)
        each = [residuals(skies[name], drawn[name], of_shipped[name].spread) for name in skies]
        print(f"{names}: {np.sqrt(sum(np.sum(r**2) for r in each) / len(each)):.3f}", flush=True)
        return np.concatenate(each)

    def deviations(place: Array) -> Array:
        return deviations_at(tuple(place))

    def slopes(place: Array) -> Array:
        """Differences over a step that noise does not hide."""
        here = deviations(place)
        steps = np.where(place > 0.5, -STEP, STEP) * np.eye(place.size)
        return np.stack([(deviations(place + step) - here) / step.sum() for step in steps], axis=1)

    middle = np.full(len(CONSTANTS), 0.5)
    found = least_squares(
        deviations, middle, slopes, bounds=(0.0, 1.0), ftol=0.01, max_nfev=MOST_STEPS
    )
    return constants(found.x)


def folds(folder: Path) -> Lines:
    """Write the constants of each fit, and how far it is from each hour; bold: hours it never saw.

    Each fit is a column; the first one has the shipped constants.
    """
    skies = hours(folder)
    found = [SHIPPED, *share_work(partial(fitted, folder), FITS, WORKERS)]
    drawn = drawn_with(found, skies)
    yield from header(TITLES)
    for name, (title, *_) in CONSTANTS.items():
        yield row([title, *(f"{float(f'{constants[name]:.3g}'):g}" for constants in found)])
    yield from errors(skies, drawn, SEEN)
    real = figures(skies["HOPE"], skies["HOPE"].index)
    for figure in SHOWN:
        at = list(real).index(figure)
        measured, spread_of_it = real[figure], drawn[0]["HOPE"].spread[at]
        first, second = written(figure, measured), written(figure, spread_of_it)
        values = [written(figure, one["HOPE"].mean[at]) for one in drawn]
        yield row([f"HOPE, {figure}: measured {first}, spread {second}", *values])


def drawn_with(found: list[Constants], skies: dict[str, Sky]) -> list[dict[str, Drawn]]:
    """Draw the skies by which each set of constants is judged."""
    return share_work(partial(draw, skies, seeds=SEEDS_OF_ERROR), found, WORKERS)


def errors(
    skies: dict[str, Sky], drawn: list[dict[str, Drawn]], seen: Sequence[tuple[str, ...]]
) -> Lines:
    """Write the error of each sky with each set of constants, bold where the set never saw it."""
    for name, sky in skies.items():
        spread = drawn[0][name].spread
        each = [float(np.linalg.norm(residuals(sky, one[name], spread))) for one in drawn]
        cells = [
            f"{error:.2f}" if name in hours_of else f"**{error:.2f}**"
            for error, hours_of in zip(each, seen, strict=True)
        ]
        yield row([f"error of {name}", *cells])


def blind(folder: Path) -> Lines:
    """Judge the fits that stand in the document by the skies that nobody had seen."""
    read = {sky.name.removeprefix("plant, hour "): sky for sky in blind_skies(folder)}
    skies = {name: every_2_s(sky) for name, sky in read.items()}
    if not skies:
        return
    rows = {title: cells for title, *cells in read_table("clouds.md", "folds")}
    columns = zip(*(rows[title] for title, *_ in CONSTANTS.values()), strict=True)
    found = [dict(zip(CONSTANTS, map(float, column), strict=True)) for column in columns]
    afterwards: dict[str, Drawn] = {}
    for name, sky in skies.items():
        afterwards |= draw({name: sky}, SHIPPED | AFTERWARDS[name], SEEDS_OF_ERROR)
    yield from header([*TITLES, "by hand, afterwards"])
    yield from errors(skies, [*drawn_with(found, skies), afterwards], [*SEEN, tuple(skies)])


TABLES: Final[Tables] = {"blind errors": blind}

if __name__ == "__main__":
    began = time.monotonic()
    data = Path(sys.argv[1])
    write_table("clouds.md", "folds", folds(data))
    write_table("clouds.md", "blind errors", blind(data))
    print(f"{(time.monotonic() - began) / 60.0:.0f} min")
