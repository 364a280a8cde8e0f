"""Measures what each term of the control law gains: `make terms DATA=FOLDER`.

    python docs/terms.py DATA [TERM...]

Each term is turned off by itself in a copy of the sources, and the copy controls the same plants
under the same skies. Writes `docs/tables/results-terms.csv`, and what pages show of it.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product, starmap
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from agents.plan import RunPlan
from agents.settings import Actuator
from docs.measured import (
    BOTH,
    CAUSES,
    CELLS,
    WORKERS,
    Lines,
    StepDays,
    hard_cells,
    skies_of,
    step_days,
    step_rows,
)
from docs.shown import fill, write
from heliarch import load_scenario
from results.figures import energy_figures
from scenarios.preparation import prepare
from scenarios.run_options import RunOptions
from scenarios.settings import with_settings
from sim_plant.profile import Profile
from studies.arrays.schemes import run_scheme

REPOSITORY: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = (
    *("agents", "bus_schemas", "docs", "heliarch", "launch_scripts", "live_page", "recordings"),
    *("results", "scenarios", "sim_plant", "studies", "sunspec"),
)
CORRECTION: Final = "correction.py"
FORECAST: Final = "forecast.py"

TERMS: Final = {
    "the whole law": (CORRECTION, "", ""),
    "the correction by the plant's meter": (CORRECTION, "if is_free or not law.is_on:", "if True:"),
    "its share is learned": (
        CORRECTION,
        "_share(helped_kw2, tried_kw2, law.rating_kw) * lacking_kw",
        "lacking_kw",
    ),
    "in that, bounded errors": (
        CORRECTION,
        "min(max(would_kw, -abs(lacking_kw)), abs(lacking_kw))",
        "would_kw",
    ),
    "its bound": (
        CORRECTION,
        "HIGHEST_CORRECTION: Final = 0.1",
        "HIGHEST_CORRECTION: Final = 10.0",
    ),
    "less of it with a delay": (CORRECTION, "/ (1.0 + delay_s / time_s)", ""),
    "no error between earlier aims": (CORRECTION, "in range(turns):", "in range(1):"),
    "none while all were free": (CORRECTION, "nan if is_free else aim_kw", "aim_kw"),
    "none on a ramp": (
        CORRECTION,
        "is_on_its_way = law.is_ramped and",
        "is_on_its_way = False and",
    ),
    "losses are known": (
        CORRECTION,
        "gross_kw(known.aim_kw, grid) if law.is_on else known.aim_kw",
        "known.aim_kw",
    ),
    "the trend": (FORECAST, "MOST_DAMPING: Final = 0.8", "MOST_DAMPING: Final = 0.0"),
    "its damping is learned": (
        FORECAST,
        "return min(max(share, 0.0), MOST_DAMPING)",
        "return MOST_DAMPING + 0.0 * share",
    ),
    "it is smoothed": (FORECAST, "TREND_TIME_S: Final = 0.5", "TREND_TIME_S: Final = 0.0"),
    "a fall takes a share": (
        FORECAST,
        "return maximum_kw * maximum_kw / (maximum_kw - change_kw)",
        "return max(maximum_kw + change_kw, 0.0)",
    ),
    "held at the forecast": (
        FORECAST,
        "if setpoint_kw > known.power_kw * (1.0 + ROUNDING):",
        "if rating_kw > 0.0:",
    ),
    "room by the forecast's error": (
        FORECAST,
        "HELD_SPREADS: Final = 0.7",
        "HELD_SPREADS: Final = 0.0",
    ),
    "in that, shadows behind limits": (
        FORECAST,
        "elif now.is_seen and not last.is_stated and",
        "elif False and",
    ),
    "room by the rating": (FORECAST, "HELD_SHARE: Final = 0.005", "HELD_SHARE: Final = 0.0"),
    "a hidden maximum grows": (
        FORECAST,
        "HIDDEN_GROWTH_PER_S: Final = 0.01",
        "HIDDEN_GROWTH_PER_S: Final = 0.0",
    ),
    "lower alpha behind limits": (
        FORECAST,
        "HIDDEN_ALPHA_MIN: Final = 1e-3",
        "HIDDEN_ALPHA_MIN: Final = 0.05",
    ),
    "how a meter reads a limit is learned": (
        FORECAST,
        "meter = _learned_reading(maximum_kw / limit_kw, cycle_s, meter)",
        "pass",
    ),
    "in that, bounded readings": (
        FORECAST,
        "MOST_LEARNED_ERRORS: Final = 2.0",
        "MOST_LEARNED_ERRORS: Final = 1e9",
    ),
    "in that, a bounded bias": (FORECAST, "MOST_BIAS: Final = 0.03", "MOST_BIAS: Final = 0.5"),
    "it corrects free readings": (
        FORECAST,
        "maximum_kw = min(maximum_kw / meter.reads, rating_kw)",
        "pass",
    ),
    "a tolerance by the meter's error": (
        FORECAST,
        "BOUND_ERRORS: Final = 5.0",
        "BOUND_ERRORS: Final = 0.0",
    ),
    "a small one if asked for all": (FORECAST, "    if asked_for_all:\n", "    if False:\n"),
    "the bias of statements is learned": (
        FORECAST,
        "meter = _learned_share(maximum_kw / available_kw, cycle_s, meter)",
        "pass",
    ),
    "statements far off are not believed": (
        FORECAST,
        "believes = abs(maximum_kw - given_kw) <= WIDEST_BOUND_TOLERANCE * given_kw",
        "believes = True",
    ),
    "setpoints add up to more than there is": (
        "allocation.py",
        "if adds_up and dark_kw > 0.0:",
        "if False and dark_kw > 0.0:",
    ),
}
"""Each term: its file in agents/control, and the text that turns it off in place of its own."""

SKIES: Final = ("measured", "oahu", "hard skies", "utility, by its meter", "meters 1 % off")
STATED: Final = "stated 2 % high"
OVERSHOOT: Final = "overshoot"
FOR_LIMITS: Final = (STATED, OVERSHOOT)
"""Columns: sums of both errors by sky, and the worst overshoot beyond the paper's rule."""

Cell = tuple[RunPlan, Profile, Actuator]


class Cells(NamedTuple):
    """What the law controls: runs by the title of their column, and steps under a clear sky."""

    runs: dict[str, list[Cell]]
    steps: StepDays


def cells(data: Path) -> Cells:
    runs: dict[str, list[Cell]] = {}
    for actuator in BOTH:
        skies = (
            measured_cells(data),
            synthetic_cells("oahu"),
            [day for days in hard_cells().values() for day in days],
            synthetic_cells("utility"),
            synthetic_cells("oahu", bias=0.01),
        )
        for title, days in zip(SKIES, skies, strict=True):
            runs[f"{title}, {actuator}"] = [(*day, actuator) for day in days]
    stated = measured_cells(data, **{"plant.available_bias": [0.02]})
    runs[STATED] = [(*day, "limit") for day in stated]
    return Cells(runs, step_days())


def measured_cells(data: Path, **states: list[float]) -> list[tuple[RunPlan, Profile]]:
    found = []
    for scenario, settings in skies_of(data).values():
        varied = {**CELLS, **settings, **states}
        for values in product(
            *(value if isinstance(value, list) else [value] for value in varied.values())
        ):
            changed = with_settings(scenario, list(zip(varied, values, strict=True)))
            day = prepare(changed, RunOptions(), "terms")
            found.append((day.plan, day.profile))
    return found


def synthetic_cells(scenario: str, bias: float = 0.0) -> list[tuple[RunPlan, Profile]]:
    """Return half an hour of six skies; the inverters' meters read wrong by up to `bias`."""
    found = []
    for seed in range(1, 7):
        day = prepare(load_scenario(scenario), RunOptions(seed=seed, duration="30m"), "terms")
        drawn = np.random.default_rng(seed).uniform(-bias, bias, day.profile.meter_error.shape[1])
        found.append((day.plan, replace(day.profile, meter_error=day.profile.meter_error + drawn)))
    return found


def figures(known: Cells) -> dict[str, float]:
    """Return the mean sum of both errors, and the worst overshoot beyond that of the paper's rule.

    They are of the law as it stands in the sources that run.
    """
    found = {title: fmean(starmap(error, runs)) for title, runs in known.runs.items()}
    beyond = max(both[1] - both[0] for *_, both, _ in step_rows(known.steps))
    return found | {OVERSHOOT: beyond}


def error(plan: RunPlan, profile: Profile, actuator: Actuator) -> float:
    """Return both errors together, by the plant's meter if that is known to be wrong."""
    run = run_scheme("predictive", plan, profile, actuator)[0]
    reads = 1.0 + plan.grid.meter_error_percent / 100.0
    found = energy_figures(
        run.desired_kw, reads * run.available_kw, reads * run.delivered_kw, run.cycle_s
    )
    return sum(found.get(cause) or 0.0 for cause in CAUSES)


def without(term: str, known: Path) -> dict[str, float]:
    """Return the figures of a copy of the sources in which a term is off."""
    name, own, off = TERMS[term]
    with TemporaryDirectory(prefix="heliarch-terms-") as folder:
        for package in PACKAGES:
            shutil.copytree(REPOSITORY / package, Path(folder, package))
        source = Path(folder, "agents", "control", name)
        text = source.read_text(encoding="utf-8")
        if own and text.count(own) != 1:
            raise SystemExit(f"{name}: expected once {own!r}, got it {text.count(own)} times")
        source.write_text(text.replace(own, off) if own else text, encoding="utf-8")
        environment = os.environ | {"PYTHONPATH": folder}
        command = [sys.executable, "docs/terms.py", str(known)]
        ran = subprocess.run(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, check=True
        )
    return dict(json.loads(ran.stdout))


def rows(data: Path, terms: Sequence[str]) -> Lines:
    yield ["without", "actuator", *SKIES, *FOR_LIMITS]
    with TemporaryDirectory(prefix="heliarch-cells-") as folder:
        known = Path(folder, "cells")
        known.write_bytes(pickle.dumps(cells(data)))
        with ThreadPoolExecutor(WORKERS) as pool:
            for term, found in zip(
                terms, pool.map(partial(without, known=known), terms), strict=True
            ):
                for actuator in BOTH:
                    titles = [f"{sky}, {actuator}" for sky in SKIES]
                    for_limits = [f"{found[title]:.3f}" for title in FOR_LIMITS]
                    last = for_limits if actuator == "limit" else ["-"] * len(FOR_LIMITS)
                    yield [term, actuator, *(f"{found[title]:.3f}" for title in titles), *last]


def main() -> None:
    given, *terms = sys.argv[1:]
    if Path(given).is_dir():
        write("results-terms", rows(Path(given), terms or list(TERMS)))
        fill()
    else:
        print(json.dumps(figures(pickle.loads(Path(given).read_bytes()))))


if __name__ == "__main__":
    main()
