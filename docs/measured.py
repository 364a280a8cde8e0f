"""Measures the tables of the documents: `make results DATA=FOLDER PAGES=delays.md`.

    python docs/measured.py [DATA] [PAGE...] [TABLE...]

Each table is written whole to `docs/tables/PAGE-NAME.csv`, and what pages show of it into the
pages (see `shown.py`). DATA holds the measurements in folders of their own; without it, tables that
rest on them stay as they are. With pages, such as clusters.md, only theirs are measured; with names
of tables too, such as plant-meter, only those.
"""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd
from msgspec.structs import replace as replace_fields
from scipy import stats

from agents.control.clusters import geographic_clusters, search_clusters
from agents.control.correlation import hourly_correlation
from agents.control.offers import MISSED_SHARE, firm_share, nothing_offered
from agents.plan import RunPlan, changed
from agents.settings import Actuator, OfferedCommitment, StorageSettings
from bus_schemas.tree import ROOT
from docs.shown import Found, fill, keep, write
from heliarch import compare, load_scenario, simulate
from recordings.read.series import RunSeries
from results.answers import Answer, answer, answers
from results.figures import energy_figures, run_figures
from results.regulation import requests_fulfilled
from scenarios.fleet import SEEDS_APART
from scenarios.preparation import Preparation, prepare
from scenarios.run_options import RunOptions
from scenarios.scenario import DcCurrents, MeasuredIrradiance, ScenarioFile
from scenarios.settings import with_settings
from sim_plant.meters import Meters
from sim_plant.profile import Profile
from studies.arrays.closed_loop import run_loop
from studies.arrays.schemes import reference_groups, run_scheme
from studies.compare.by_agents import run_by_agents

WORKERS: Final = 2
BOTH: Final[tuple[Actuator, ...]] = ("fraction", "limit")
HIERARCHICAL: Final = ("paper", "predictive")

Lines = Iterator[Sequence[object]]
Columns = Mapping[str, tuple[str, int | None]]
"""Title of each column of a table, and the decimals of its numbers; None for words."""

CASE: Final[Columns] = {"scheme": ("scheme", None), "actuator": ("actuator", None)}
COMMITMENT: Final[Columns] = {
    "satisfied": ("satisfied %", 2),
    "control-caused": ("control-caused %", 3),
    "over-delivered": ("over-delivered %", 3),
    "rmse": ("RMSE kW", 1),
    "regd-feasible": ("RegD of the feasible, to 1 %", 2),
    "score": ("PJM score", 3),
}


CAUSES: Final = ["control-caused", "over-delivered"]
ERRORS: Final = tuple(f"{name} %" for name in CAUSES)


def table(rows: pd.DataFrame, columns: Columns) -> Lines:
    """Write these columns of a comparison."""
    yield [title for title, _ in columns.values()]
    for _, entry in rows.fillna({"actuator": "-"}).iterrows():
        yield [
            entry[name] if decimals is None else f"{entry[name]:.{decimals}f}"
            for name, (_, decimals) in columns.items()
        ]


# docs/results.md


def case_study() -> Lines:
    rows = compare("oahu-day", actuators=BOTH)
    return table(rows[rows["scheme"] != "grouping worst"], {**CASE, **COMMITMENT})


def skies() -> Lines:
    """Write means over a hundred skies."""
    schemes = ("uniform-cap", *HIERARCHICAL)
    rows = compare("oahu", schemes=schemes, actuators=BOTH, seeds=range(1, 101), workers=WORKERS)
    yield ["scheme", "actuator", ERRORS[0], "5 to 95 %", ERRORS[1], "unavoidable %"]
    for names, group in rows.groupby(["scheme", "actuator"], sort=False):
        missing, beyond = group["control-caused"], group["over-delivered"]
        spread = f"{missing.quantile(0.05):.3f} to {missing.quantile(0.95):.3f}"
        unavoidable = f"{group['unavoidable'].mean():.3f}"
        yield [*names, f"{missing.mean():.3f}", spread, f"{beyond.mean():.2f}", unavoidable]


def cycle_lengths() -> Lines:
    cycles = {"time.cycle_s": [0.1, 1, 10, 60]}
    rows = compare(
        "oahu",
        schemes=HIERARCHICAL,
        actuators=BOTH,
        duration="30m",
        settings=cycles,
        workers=WORKERS,
    )
    figures = {name: COMMITMENT[name] for name in ("control-caused", "over-delivered", "rmse")}
    return table(rows, {"time.cycle_s": ("cycle [s]", None), **CASE, **figures})


def hope(data: Path) -> ScenarioFile:
    return load_scenario("hope-melpitz", data / "hope-melpitz-1s")


def real_plant(data: Path) -> ScenarioFile:
    return load_scenario("plant20mw", data / "plant20mw-combiners-10s")


def hour(letter: str) -> dict[str, Any]:
    return {"irradiance.currents": f"hour_{letter}.csv"}


CELLS: Final = {"commitment.share": [0.5, 0.7, 0.8, 0.9], "plant.meter_noise": [0, 0.005]}


def skies_of(data: Path) -> dict[str, tuple[ScenarioFile, dict[str, Any]]]:
    """Return the scenario of each measured sky, and its settings."""
    hours = {f"hour {letter}": (real_plant(data), hour(letter)) for letter in "abc"}
    return {"HOPE": (hope(data), {}), **hours}


@cache
def known_skies(data: Path) -> pd.DataFrame:
    """Compare on four measured skies: 4 commitments, without and with 0.5 % of meter noise.

    The offset is turned under the first seed of that noise.
    """
    run = partial(compare, actuators=BOTH, workers=WORKERS)
    tables = []
    for sky, (scenario, settings) in skies_of(data).items():
        cases = {**CELLS, **settings}
        aims = {**cases, "control.offset_errors": [0.0, 0.5, 1.0, 1.5, 2.0]}
        tables += [
            run(scenario, schemes=["paper"], settings=cases).assign(sky=sky),
            run(scenario, schemes=["predictive"], settings=aims).assign(sky=sky),
        ]
    return pd.concat(tables).fillna({"control.offset_errors": 0.0})


@cache
def noisy_skies(data: Path) -> pd.DataFrame:
    """Compare on the same skies under five seeds of that noise."""
    seeds = {"plant.meter_noise": [0.005], "plant.meter_seed": [*range(5)]}
    run = partial(compare, schemes=HIERARCHICAL, actuators=BOTH, workers=WORKERS)
    return pd.concat(
        run(scenario, settings={**CELLS, **seeds, **settings}).assign(sky=sky)
        for sky, (scenario, settings) in skies_of(data).items()
    )


def noise(data: Path) -> Lines:
    """Write what the seed of the noise changes: least and most of the means over its 16 cells."""
    yield ["actuator", "scheme", "seeds", *ERRORS, "at most the paper's, of 16"]
    names = ["plant.meter_seed", "sky", "commitment.share"]
    cells = noisy_skies(data).set_index(["actuator", "scheme", *names])[CAUSES].sort_index()
    for actuator in BOTH:
        for scheme in HIERARCHICAL:
            of_scheme = cells.loc[actuator, scheme]
            apart = of_scheme - cells.loc[actuator, "paper"]
            counts = (apart <= 5e-4).all(axis=1).groupby(names[0]).sum()
            means = of_scheme.groupby(names[0]).mean()
            spans = (f"{means[name].min():.3f} to {means[name].max():.3f}" for name in CAUSES)
            yield [actuator, scheme, len(means), *spans, f"{counts.min()} to {counts.max()}"]


def measured_skies(data: Path) -> Lines:
    """Write control-caused / over-delivered by sky and commitment, means without and with noise."""
    rows = known_skies(data)
    rows = rows[rows["control.offset_errors"] == 0.0]
    shares = sorted(rows["commitment.share"].unique())
    yield ["sky", "actuator", "scheme", *(f"{share:.0%}" for share in shares)]
    for names, group in rows.groupby(["sky", "actuator", "scheme"], sort=False):
        means = group.groupby("commitment.share")[CAUSES].mean()
        yield [*names, *(f"{missed:.3f} / {over:.3f}" for missed, over in means.to_numpy())]


def offsets(data: Path) -> Lines:
    """Write means over all cells, and in how many both errors are at most those of `paper`."""
    rows = known_skies(data)
    names = ["sky", "commitment.share"]
    cells = rows.set_index([*names, "plant.meter_noise"])
    titles = ["actuator", "scheme", "offset_errors", *ERRORS, "sum %", "at most the paper's"]
    yield titles
    keys = ["actuator", "scheme", "control.offset_errors"]
    for (actuator, scheme, aim), group in cells.groupby(keys, sort=False):
        is_paper = (cells["actuator"] == actuator) & (cells["scheme"] == "paper")
        apart = group[CAUSES] - cells.loc[is_paper, CAUSES].reindex(group.index)
        missed, over = group[CAUSES].mean()
        count = (apart <= 5e-4).all(axis=1).sum()
        figures = (f"{missed:.3f}", f"{over:.3f}", f"{missed + over:.3f}", count)
        yield [actuator, scheme, f"{aim:g}", *figures]


def intervals(data: Path) -> Lines:
    """Write how much less is missed and over-delivered than by the paper: skies are the unit.

    Intervals are Student's: four skies are few.
    """
    rows = known_skies(data)
    rows = rows[rows["control.offset_errors"] == 0.0]
    means = rows.groupby(["actuator", "scheme", "sky"])[CAUSES].mean()
    yield ["actuator", "skies", *(f"{name}, 95 %" for name in ERRORS)]
    for actuator in BOTH:
        apart = (means.loc[actuator, "predictive"] - means.loc[actuator, "paper"]).to_numpy()
        count, mean = len(apart), apart.mean(axis=0)
        half = stats.t.ppf(0.975, count - 1) * apart.std(axis=0, ddof=1) / np.sqrt(count)
        spans = zip(mean, mean - half, mean + half, strict=True)
        cells = (f"{one:+.3f} ({least:+.3f} to {most:+.3f})" for one, least, most in spans)
        yield [actuator, count, *cells]


NEW_CELLS: Final = {"share": [0.4, 0.6, 0.75, 0.95], "plant.meter_noise": [0, 0.005]}
OAHU_GRID: Final = {"apart_m": 150, "lat": 21.31, "lon": -158.08}


def other_skies(data: Path) -> Lines:
    """Write the same counts for skies, plants and commitments that no other table uses."""
    pyranometers = pd.read_csv(data / "hope-melpitz-1s" / "positions.csv", dtype=str)["station"]
    known = hope(data).scenario.irradiance
    assert isinstance(known, MeasuredIrradiance)
    others = [name for name in pyranometers if name not in (known.stations or ())]
    large = {
        "inverters": None,
        "grid": {"rows": 6, "columns": 10, **OAHU_GRID},
        "rating_kw": 30_000,
    }
    small = {"inverters": None, "grid": {"rows": 3, "columns": 3, **OAHU_GRID}, "rating_kw": 4500}
    melpitz: dict[str, dict[str, Any]] = {
        "HOPE, 17 other stations": {"irradiance.stations": others[:17]},
        "HOPE, 9 others in two clusters": {
            "irradiance.stations": others[-9:],
            "control.cluster_sizes": [[5, 4]],
        },
        "HOPE, cycles of 5 s": {"time.cycle_s": 5},
    }
    oahu: dict[str, dict[str, Any]] = {
        "oahu, cloud cover 0.7": {"irradiance.clouds.cloud_cover": 0.7},
        "oahu, 60 inverters in four tiers": {
            "plant": large,
            "control": {"cluster_sizes": None, "cluster_count": [12, 3]},
        },
        "oahu, 9 inverters, cycles of 10 s": {
            "plant": small,
            "control": {"cluster_sizes": None, "cluster_count": [2]},
            "time.cycle_s": 10,
        },
    }
    titles = (f"{what}, {actuator}" for actuator in BOTH for what in ("at most", "sum %"))
    yield ["sky and plant", "cells", *titles]
    shares = [{"kind": "share-of-median", "share": share} for share in NEW_CELLS["share"]]
    cells = {"commitment": shares, "plant.meter_noise": NEW_CELLS["plant.meter_noise"]}
    for sky, settings in (melpitz | oahu).items():
        scenario = hope(data) if sky in melpitz else load_scenario("oahu")
        scenario = with_settings(scenario, [*settings.items(), ("plant.meter_seed", 7)])
        skies = {} if sky in melpitz else {"seeds": range(101, 107), "duration": "30m"}
        run = partial(compare, scenario, schemes=HIERARCHICAL, actuators=BOTH, workers=WORKERS)
        rows = run(settings=cells, **skies)
        figures: list[object] = []
        for actuator in BOTH:
            errors = rows[rows["actuator"] == actuator].set_index("scheme")[CAUSES]
            paper, found = errors.loc["paper"], errors.loc["predictive"]
            apart = found.to_numpy() - paper.to_numpy()
            sums = (f"{one.sum(axis=1).mean():.3f}" for one in (paper, found))
            figures += [(apart <= 5e-4).all(axis=1).sum(), " / ".join(sums)]
        yield [sky, len(apart), *figures]


HARD_CYCLES: Final = 1800
BRIGHT, DARK = 0.95, 0.2
"""What inverters have of their rating without a cloud, and under one."""


def edges(seed: int, speed_ms: float, positions_m: np.ndarray) -> np.ndarray:
    """Return shadows with hard edges, 300 m long in the mean, over inverters, shape (T, n)."""
    draws = np.random.default_rng(seed)
    ends_m = np.cumsum(draws.exponential(300.0, 200 + int(speed_ms * HARD_CYCLES / 100.0)))
    angle = draws.uniform(0.0, 2.0 * np.pi)
    along_m = positions_m @ [np.cos(angle), np.sin(angle)]
    metres = np.arange(int(speed_ms * (HARD_CYCLES + 2) + np.ptp(along_m)) + 2)
    is_dark = np.searchsorted(ends_m, metres) % 2 == 1
    summed = np.concatenate([[0.0], np.cumsum(np.where(is_dark, DARK, BRIGHT))])
    start = along_m - along_m.min() + speed_ms * np.arange(HARD_CYCLES)[:, None]
    first, last = start.astype(int), (start + speed_ms).astype(int) + 1
    return np.asarray((summed[last] - summed[first]) / (last - first))


def switched(seed: int, chance: float, inverters: int) -> np.ndarray:
    """Return inverters that go dark and bright at random, each by itself, shape (T, n)."""
    flips = np.random.default_rng(seed).random((HARD_CYCLES, inverters)) < chance
    return np.where(np.cumsum(flips, axis=0) % 2, DARK, BRIGHT)


def checkerboard(cycles: int, inverters: int) -> np.ndarray:
    """Return inverters of which every other one is dark, and then the others, shape (T, n)."""
    turns = np.arange(HARD_CYCLES)[:, None] // cycles + np.arange(inverters)
    return np.where(turns % 2, DARK, BRIGHT)


def hard_cells() -> dict[str, list[tuple[RunPlan, Profile]]]:
    """Return plants and skies whose changes cannot be foreseen, by the name of the sky."""
    day = prepare(load_scenario("oahu"), RunOptions(duration=f"{HARD_CYCLES}s"), "hard")
    rating_kw = np.array([day.plan.tree.rating_kw(leaf) for leaf in day.plan.tree.leaves])
    positions_m, count = np.array(day.plan.site.positions_m), len(rating_kw)
    skies: dict[str, list[np.ndarray]] = {
        f"hard edges, {speed} m/s": [edges(seed, speed, positions_m) for seed in range(500, 506)]
        for speed in (7, 15)
    }
    skies["on and off, 0.3 a cycle"] = [switched(seed, 0.3, count) for seed in range(50, 53)]
    for cycles in (3, 8):
        skies[f"checkerboard of {cycles} s"] = [checkerboard(cycles, count)]
    runs = {
        sky: [
            (day.plan, Profile(share * rating_kw, np.full(HARD_CYCLES, part * median_kw)))
            for share in shares
            for median_kw in [float(np.median((share * rating_kw).sum(axis=1)))]
            for part in (0.5, 0.8)
        ]
        for sky, shares in skies.items()
    }
    for title, changes in {
        "oahu, cycles of 5 s": [("time.cycle_s", 5)],
        "oahu, cycles of 10 s": [("time.cycle_s", 10)],
        "oahu, meters with 5 % of noise": [("plant.meter_noise", 0.05)],
    }.items():
        scenario = with_settings(load_scenario("oahu"), changes)
        options = [RunOptions(seed=seed, duration="30m") for seed in range(301, 307)]
        days = [prepare(scenario, one, "hard") for one in options]
        runs[title] = [(one.plan, one.profile) for one in days]
    return runs


def hard_skies() -> Lines:
    """Write what is missed and over-delivered where a change cannot be foreseen."""
    yield ["sky", *(f"{scheme}, {actuator}" for actuator in BOTH for scheme in HIERARCHICAL)]
    for sky, cells in hard_cells().items():
        cell: list[str] = []
        for actuator, scheme in product(BOTH, HIERARCHICAL):
            found = [
                run_figures(run_scheme(scheme, plan, profile, actuator)[0])
                for plan, profile in cells
            ]
            means = [np.mean([float(one[name] or 0.0) for one in found]) for name in CAUSES]
            cell.append(f"{means[0]:.2f} / {means[1]:.2f}")
        yield [sky, *cell]


STATES: Final[dict[str, dict[str, list[float]]]] = {
    "none": {},
    "all, exactly": {"plant.available_bias": [0.0]},
    "all, 2 % high": {"plant.available_bias": [0.02]},
    "all, 2 % low": {"plant.available_bias": [-0.02]},
    "one in four, exactly": {"plant.available_bias": [0.0], "plant.available_share": [0.25]},
}


def stated(data: Path) -> Lines:
    """Write what it is worth that inverters state their available power, behind limits."""
    yield ["inverters that state it", *ERRORS, "sum %"]
    run = partial(compare, schemes=["predictive"], actuators=["limit"], workers=WORKERS)
    for title, states in STATES.items():
        found = [
            run(scenario, settings={**CELLS, **settings, **states})
            for scenario, settings in skies_of(data).values()
        ]
        missed, over = pd.concat(found)[CAUSES].mean()
        yield [title, f"{missed:.3f}", f"{over:.3f}", f"{missed + over:.3f}"]


FOLLOWS: Final = {
    "at once": {},
    **{f"by {ramp} %/s": {"plant.ramp_percent_per_s": ramp} for ramp in (33, 20, 10, 3)},
    **{f"after {delay_s} s": {"plant.delay_s": delay_s} for delay_s in (1, 3, 10)},
    "after 1 s by 10 %/s": {"plant.delay_s": 1, "plant.ramp_percent_per_s": 10},
    "after 3 s by 3 %/s": {"plant.delay_s": 3, "plant.ramp_percent_per_s": 3},
}
STEPS_KW: Final = {
    **{"start": 3500, "up": 5000, "down": 2000, "into saturation": 8000},
    **{"out of saturation": 4500, "up, broken off": 6000, "on a ramp": 2500},
}
STEPS_AT_S: Final = (0, 120, 240, 360, 480, 600, 604, 720)


StepDays = list[tuple[str, int, RunPlan, Profile]]


def step_days() -> StepDays:
    """Return how inverters follow, the length of a cycle, and the plan and profile of the steps."""
    days: StepDays = []
    for cycle_s in (1, 4):
        cycles = np.diff(STEPS_AT_S) // cycle_s
        commitment_kw = np.repeat([float(kw) for kw in STEPS_KW.values()], cycles)
        for title, follows in FOLLOWS.items():
            clear = {"time.cycle_s": cycle_s, "irradiance.clouds.cloud_cover": 0} | follows
            scenario = with_settings(load_scenario("oahu"), [*clear.items()])
            day = prepare(scenario, RunOptions(duration="12m"), "steps")
            profile = replace(day.profile, commitment_kw=commitment_kw)
            days.append((title, cycle_s, day.plan, profile))
    return days


def step_rows(days: StepDays) -> list[tuple[str, int, str, list[float], list[float | None]]]:
    """Return overshoot and settling time of each step, by the paper's rule and by `predictive`."""
    rows = []
    for title, cycle_s, plan, profile in days:
        runs = [run_scheme(name, plan, profile, "limit")[0] for name in HIERARCHICAL]
        start = [_start_of(run, STEPS_AT_S[1] // cycle_s) for run in runs]
        for place, step in enumerate(STEPS_KW):
            if step not in {"into saturation", "up, broken off"}:
                both = start if place == 0 else [answers(run)[place - 1] for run in runs]
                beyond = [one.overshoot_percent or 0.0 for one in both]
                rows.append((title, cycle_s, step, beyond, [one.settling_s for one in both]))
    return rows


def steps() -> Lines:
    """Write how every step is answered under a clear sky, the worst overshoot first."""
    yield ["inverters follow", "cycle [s]", "step", *STEP_FIGURES]
    for *words, beyond, settled in sorted(step_rows(step_days()), key=lambda row: -row[3][1]):
        figures = [f"{beyond[1]:.2f}", f"{beyond[0]:.2f}", f"{settled[1]:.0f}", f"{settled[0]:.0f}"]
        yield [*words, *figures]


STEP_FIGURES: Final = ("overshoot %", "by the paper's rule", "settled s", "by the paper's")


def _start_of(run: RunSeries, cycles: int) -> Answer:
    """Return the answer to what is asked when the run begins."""
    powers_kw = (run.dispatch_kw, run.delivered_kw, run.available_kw)
    parts = [power_kw[:cycles] for power_kw in powers_kw]
    return answer(*parts, float(run.delivered_kw[0]), run.cycle_s, run.rating_kw)


# The paper's own figures, and what they are here

DAY_GROUPS: Final = {"grouping median": "grouping", "paper": "paper", "predictive": "predictive"}
CAPACITY_PERCENT: Final = (0.1, 1, 2, 5, 10, 20)


def errors_of(run: RunSeries) -> float:
    """Return what `compare` ranks reference groups by, in % of the dispatched energy."""
    desired_kw, powers_kw = run.desired_kw, (run.available_kw, run.delivered_kw)
    found = energy_figures(desired_kw, *powers_kw, run.cycle_s)
    return float(sum(found[name] or 0.0 for name in CAUSES))


@cache
def paper_day(actuator: Actuator) -> dict[str, RunSeries]:
    """Return the runs of `oahu-day`: the median reference group of grouping, and the hierarchy."""
    day = prepare(load_scenario("oahu-day"), RunOptions(), "paper")
    tried: list[tuple[float, np.ndarray]] = []
    for group in reference_groups(len(day.plan.tree.leaves)):
        (run,) = run_scheme("grouping", day.plan, day.profile, actuator, [group])
        tried.append((errors_of(run), group))
    tried.sort(key=lambda one: one[0])
    groups = [tried[len(tried) // 2][1]]
    return {
        title: run_scheme(name, day.plan, day.profile, actuator, groups)[0]
        for title, name in DAY_GROUPS.items()
    }


def regd() -> Lines:
    """Write which requests are fulfilled, by the tolerance as a share of the capacity offered."""
    yield ["scheme", "actuator", "requests", *(f"{percent} %" for percent in CAPACITY_PERCENT)]
    for actuator in BOTH:
        for title, run in paper_day(actuator).items():
            capacity_kw = run.plan.site.regulation_capacity_kw
            found = [
                requests_fulfilled(run, capacity_kw * percent / 100.0)
                for percent in CAPACITY_PERCENT
            ]
            yield [title, actuator, "all", *(f"{one.percent:.2f}" for one in found)]
            yield [title, actuator, "feasible", *(f"{one.feasible_percent:.2f}" for one in found)]


PAPER: Final = {
    "satisfied commitment [%]": ("88.36", "99.35"),
    "unsatisfied commitment [kWh]": ("8089", "435"),
    "mileage of the hierarchy = 1": ("17.5", "1"),
    "requests fulfilled [%], tolerance not stated": ("81.45", "99.88"),
    "time for 54,000 s of operation [s]": ("-", "14.144"),
    "committed energy [MWh], unsatisfied / (1 - satisfied)": ("69.5", "66.9"),
}
"""Its Tables I and II and section III, of grouping and of the hierarchy. "-": not stated."""


def paper_here() -> Lines:
    """Write each figure that the paper states beside what it is here, actuator `fraction`."""
    runs = paper_day("fraction")
    found = {title: run_figures(run) for title, run in runs.items()}

    def of_all(name: str, decimals: int, factor: float = 1.0) -> list[str]:
        return [f"{factor * figures[name]:.{decimals}f}" for figures in found.values()]

    mileage = np.array([figures["mileage"] for figures in found.values()])
    stated = {title: (title, *cells) for title, cells in PAPER.items()}
    satisfied, unsatisfied, ratio, fulfilled, took, committed = stated.values()
    yield ["figure", "paper: grouping", "paper: hierarchy", *(f"here ({title})" for title in runs)]
    yield [*satisfied, *of_all("satisfied", 2)]
    yield [*unsatisfied, *of_all("shortfall-energy", 0)]
    yield ["of it unavoidable [kWh]", "-", "-", *of_all("unavoidable-energy", 0)]
    yield ["of it control-caused [kWh]", "-", "-", *of_all("control-caused-energy", 0)]
    yield [*ratio, *(f"{one:.2f}" for one in mileage / mileage[1])]
    yield [*fulfilled, "-", "-", "-"]
    yield [*took, *took_s(runs)]
    yield ["the same through agents [s]", "-", "-", "-", "-", f"{agents_took_s():.0f}"]
    yield [*committed, *of_all("dispatched-energy", 1, 1e-3)]
    for dc_ac_ratio in (1.0, 1.3):
        clear_mwh = f"{cloudless_mwh(dc_ac_ratio):.1f}"
        title = f"a cloudless sky gives [MWh], DC/AC {dc_ac_ratio}"
        yield [title, "-", "-", *[clear_mwh] * len(runs)]


def took_s(runs: Mapping[str, RunSeries]) -> Iterator[str]:
    """Yield the processor time of each scheme over arrays; all have run before."""
    day = prepare(load_scenario("oahu-day"), RunOptions(), "paper")
    group = [next(iter(reference_groups(len(day.plan.tree.leaves), [4])))]
    for title in runs:
        began = time.process_time()
        run_scheme(DAY_GROUPS[title], day.plan, day.profile, "fraction", group)
        yield f"{time.process_time() - began:.2f}"


def agents_took_s() -> float:
    """Return the processor time of the same day through the agents."""
    day = prepare(load_scenario("oahu-day"), RunOptions(), "paper")
    began = time.process_time()
    run_by_agents(day.plan, day.profile, "predictive", "fraction")
    return time.process_time() - began


def cloudless_mwh(dc_ac_ratio: float) -> float:
    """Return the available energy of that day without a cloud."""
    clear = {"irradiance.clouds.cloud_cover": 0, "pv.dc_ac_ratio": dc_ac_ratio}
    scenario = with_settings(load_scenario("oahu-day"), [*clear.items()])
    day = prepare(scenario, RunOptions(), "clear")
    available_kw = day.profile.mpp_kw.sum(axis=1)
    return float(available_kw.sum()) * day.plan.timing.cycle_s / 3.6e6


METER_READS: Final = {"0.2": 0.2, "0.5": 0.5, "1": 1.0}
"""Most by which a meter of each class may be wrong, in % of its reading."""


def plant_meter() -> Lines:
    """Write the errors of plants whose meter is as wrong as its class allows, by truth and meter.

    What the meter reads is what is paid. It would read available power as wrongly.
    """
    yield [*("actuator", "class", "meter reads", "judged by"), *METER_COLUMNS]
    errors = [
        ("-", 0.0),
        *((name, by * most) for name, most in METER_READS.items() for by in (1, -1)),
    ]
    days = [prepare(load_scenario("oahu"), RunOptions(seed=seed), "m") for seed in range(1, 11)]
    for actuator in BOTH:
        for name, percent in errors:
            grid = {"meter_error_percent": percent}
            plans = [(changed(day.plan, grid=grid), day.profile) for day in days]
            runs = {
                scheme: [run_scheme(scheme, *one, actuator)[0] for one in plans]
                for scheme in HIERARCHICAL
            }
            for judge, factor in (("truth", 1.0), ("meter", 1.0 + percent / 100.0)):
                found = {scheme: judged(of, factor) for scheme, of in runs.items()}
                unavoidable = f"{found['paper']['unavoidable']:.3f}"
                both = (f"{found[s][cause]:.3f}" for s in HIERARCHICAL for cause in CAUSES)
                yield [actuator, name, f"{percent:+.1f} %", judge, unavoidable, *both]


METER_COLUMNS: Final = (
    "unavoidable %",
    *(f"{scheme}, {name}" for scheme in HIERARCHICAL for name in ERRORS),
)


def judged(runs: Sequence[RunSeries], factor: float) -> pd.Series:
    """Return the mean errors of runs as seen by a meter that reads a multiple of the power."""
    return pd.DataFrame(
        energy_figures(
            run.desired_kw, factor * run.available_kw, factor * run.delivered_kw, run.cycle_s
        )
        for run in runs
    ).mean()


JUDGES: Final = {"truth": "", "meter": "metered-"}
UTILITY: Final = "utility"
NO_LOSSES: Final = {"loss_constant_percent": 0.0, "loss_quadratic_percent": 0.0}
PARTS: Final[dict[str, dict[str, Any]]] = {
    "nothing": {},
    "the meter's error": {"grid.meter_error_percent": 0.0},
    "losses": {f"grid.{name}": value for name, value in NO_LOSSES.items()},
    "both": {"grid": {"meter_error_percent": 0.0, **NO_LOSSES}},
    "ramps": {"plant.ramp_percent_per_s": None},
    "the delay": {"plant.delay_s": 0.0},
    "averages over arrays": {"plant.block_m": 0.0},
    "trackers": {"pv": {"tracker_gcr": None}},
    "DC/AC 1.3": {"pv.dc_ac_ratio": 1.0},
    "noise of the inverters' meters": {"plant.meter_noise": 0.0},
}
"""Parts of `utility` that are turned off, and the settings for that."""


def realism() -> Lines:
    """Write means over ten skies of the paper's plant, and of one as plants are built today."""
    judges = (f"by the {judge} %" for judge in JUDGES)
    yield ["scenario", "scheme", "actuator", "unavoidable %", *judges, "RMSE kW"]
    for scenario in ("oahu", UTILITY):
        for (scheme, actuator), group in ten_skies(scenario).groupby(
            ["scheme", "actuator"], sort=False
        ):
            means = group.mean(numeric_only=True)
            cells = [f"{means['unavoidable']:.3f}"]
            for prefix in JUDGES.values():
                names = [f"{prefix}{cause}" for cause in CAUSES]
                is_judged = not group[names].isna().any(axis=None)
                cells.append(
                    " / ".join(f"{means[name]:.3f}" for name in names) if is_judged else "-"
                )
            yield [scenario, scheme, actuator, *cells, f"{means['rmse']:.1f}"]


def utility_parts() -> Lines:
    """Write control-caused / over-delivered in `utility` with one of its parts turned off."""
    schemes = ("uniform-cap", *HIERARCHICAL)
    yield ["without", "actuator", "judged by", *schemes]
    for title, changes in PARTS.items():
        scenario = with_settings(load_scenario(UTILITY), list(changes.items()))
        rows = ten_skies(scenario)
        means = rows.groupby(["actuator", "scheme"]).mean(numeric_only=True)
        for actuator in BOTH:
            for judge, prefix in JUDGES.items():
                names = [f"{prefix}{cause}" for cause in CAUSES]
                if judge == "truth" or not rows[names].isna().any(axis=None):
                    found = (means.loc[(actuator, scheme), names] for scheme in schemes)
                    yield [title, actuator, judge, *(f"{m:.3f} / {o:.3f}" for m, o in found)]


def ten_skies(scenario: str | ScenarioFile) -> pd.DataFrame:
    schemes = ("uniform-cap", *HIERARCHICAL)
    return compare(scenario, schemes=schemes, actuators=BOTH, seeds=range(1, 11), workers=WORKERS)


def measured_unavoidable(data: Path) -> Lines:
    """Write the unavoidable shortfall of each measured sky, and of all: means over commitments."""
    yield ["sky", "unavoidable %", "least to most"]
    run = partial(compare, schemes=["physical-limit"], workers=WORKERS)
    shares = {"commitment.share": CELLS["commitment.share"]}
    rows = {
        sky: run(scenario, settings=shares | settings)["unavoidable"]
        for sky, (scenario, settings) in skies_of(data).items()
    }
    for sky, percents in (rows | {"all four": pd.concat(rows)}).items():
        spread = f"{percents.min():.3f} to {percents.max():.3f}"
        yield [sky, f"{percents.mean():.3f}", spread]


# docs/offers.md

OFFERS: Final = (
    *("interval [s]", "reliability", "actuator", "intervals", "kept %", "promised %"),
    *("firm %", "fixed share", "promised so %"),
)
Runs = list[tuple[RunPlan, Profile]]


def offers() -> Lines:
    """Write how often promises were kept in 30 days of one plant, and how much they promised."""
    yield [*OFFERS]
    days = [offered_run("oahu-day", "07:00", "10h", seed) for seed in range(1, 31)]
    for interval_s, reliability in ((300, 0.95), (900, 0.95), (3600, 0.95), (900, 0.9)):
        yield from offered_rows(days, interval_s, reliability)


def measured_offers(data: Path) -> Lines:
    """Write the same for measured skies, each from an empty record."""
    hours = [offered_run(real_plant(data), settings=hour(letter)) for letter in "abc"]
    skies = {
        "HOPE": [offered_run(hope(data))],
        "hours a to c": hours,
        "Livermore": [offered_run(livermore(data))],
    }
    yield ["sky", *OFFERS]
    for sky, runs in skies.items():
        for interval_s in (300, 900, 3600):
            for cells in offered_rows(runs, interval_s, 0.95):
                yield [sky, *cells]


def livermore(data: Path) -> ScenarioFile:
    """Return the day of one sensor, which stands for a whole plant."""
    folder = Path(mkdtemp())
    day = pd.read_csv(data / "livermore-ghi-2s" / "ghi_20140518.csv")
    times = pd.Timestamp("2014-05-18T08:00:00Z") + pd.to_timedelta(day["t_s"], unit="s")
    day["t_s"] = times.dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    day.columns = ["utc", "1"]
    day.to_csv(folder / "ghi.csv", index=False)
    (folder / "positions.csv").write_text("station,lat,lon\n1,37.676208,-121.703118\n")
    settings = {
        "time.start": "2014-05-18T14:00:00",
        "time.duration_s": 11 * 3600,
        "time.cycle_s": 2,
        "plant.altitude_m": 200,
        "irradiance.ghi": "ghi.csv",
        "irradiance.stations": ["1"],
        "control.cluster_sizes": [[1]],
    }
    return with_settings(load_scenario("hope-melpitz", folder), list(settings.items()))


def offered_run(
    scenario: str | ScenarioFile,
    start: str | None = None,
    duration: str | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
) -> tuple[RunPlan, Profile]:
    """Prepare a run in which offers can be made.

    A plant of unknown place has no clear sky. Its rating stands for that, as it may for an hour.
    """
    loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
    loaded = with_settings(loaded, list((settings or {}).items()))
    if not isinstance(loaded.scenario.irradiance, DcCurrents):
        loaded = with_settings(loaded, [("commitment", {"kind": "offered"})])
    found = prepare(loaded, RunOptions(start=start, duration=duration, seed=seed), "offers")
    profile = found.profile
    if not profile.clear_sky_kw.size:
        rating_kw = np.full(profile.cycles, found.plan.tree.rating_kw(ROOT))
        profile = replace(profile, clear_sky_kw=rating_kw)
    return found.plan, profile


def offered_rows(runs: Runs, interval_s: int, reliability: float) -> Lines:
    """Yield the rows of an interval; none where no run has two of them."""
    cycle_s = runs[0][0].timing.cycle_s
    cycles = round(interval_s / cycle_s)
    if all(profile.cycles < 2 * cycles for _, profile in runs):
        return
    offered = OfferedCommitment(interval_s=interval_s, lead_s=60.0, reliability=reliability)
    for actuator in BOTH:
        figures = promise_figures(*promised(runs, offered, actuator)[:4], cycles)
        yield [interval_s, reliability, actuator, *figures]


def promised(runs: Runs, offered: OfferedCommitment, actuator: Any) -> list[Any]:
    """Return commitment, regulation, available, clear-sky and given power of runs in a row.

    The first interval of each is left out, since nobody has offered it, and what is no whole one.
    """
    found, record = [], None
    for of_run, profile in runs:
        plan = changed(of_run, control={"offers": offered, "actuator": actuator})
        settings = plan.offer_law
        assert settings is not None
        record = nothing_offered(settings) if record is None else record
        result = run_loop(plan, profile, "predictive", actuator, record)
        cycles = settings.interval_cycles
        whole = slice(cycles, profile.cycles // cycles * cycles)
        powers_kw = (
            result.commitment_kw,
            profile.regulation_kw,
            profile.mpp_kw.sum(axis=1),
            profile.clear_sky_kw,
            result.power_kw.sum(axis=1) + result.storage_power_kw.sum(axis=1),
        )
        found.append([kw[whole] for kw in powers_kw])
    return [np.concatenate(one) for one in zip(*found, strict=True)]


def promise_figures(
    commitment_kw: Any, regulation_kw: Any, available_kw: Any, clear_sky_kw: Any, cycles: int
) -> Iterator[str]:
    """Yield the figures of a row: intervals, kept, promised, firm, and those of a fixed share."""
    promised, regulation, available, clear = (
        kw.reshape(-1, cycles) for kw in (commitment_kw, regulation_kw, available_kw, clear_sky_kw)
    )

    def kept(committed: Any) -> Any:
        wanted = committed + regulation
        missing = np.maximum(wanted - available, 0.0).sum(axis=1)
        return missing <= MISSED_SHARE * wanted.sum(axis=1)

    coverage = kept(promised).mean()
    shares = np.arange(0.05, 1.0, 0.005)
    fixed = max(share for share in shares if kept(share * clear).mean() >= coverage)
    firm = [firm_share(index) for index in available / clear]
    most = available.sum()
    yield f"{len(promised)}"
    yield f"{100 * coverage:.1f}"
    yield f"{100 * promised.sum() / most:.1f}"
    yield f"{100 * (np.array(firm) * clear.sum(axis=1)).sum() / most:.1f}"
    yield f"{fixed:.3f}"
    yield f"{100 * fixed * clear.sum() / most:.1f}"


# docs/orders.md

ANSWERS: Final = {
    "reaction to a step, longest [s]": ("reaction_s", max, 1),
    "rise, longest [s]": ("rise_s", max, 1),
    "settled within 2.5 % of a step, longest [s]": ("settling_of_change_s", max, 1),
    "damping, least": ("damping", min, 2),
    "settled, longest [s]": ("settling_s", max, 1),
    "overshoot, largest [%]": ("overshoot_percent", max, 2),
    "error at rest, largest [%]": ("error_percent", max, 2),
    "off the ramp, largest [%]": ("ramp_deviation_percent", max, 2),
    "score of the AGC signal": ("score", min, 3),
    "reaction to a step of the frequency, longest [s]": ("reaction_s", max, 1),
    "rise after a step of the frequency, longest [s]": ("rise_s", max, 1),
    "settled after a step of the frequency, longest [s]": ("settling_of_change_s", max, 1),
    "frequency response, least energy [%]": ("response_percent", min, 1),
}


def commissioning() -> Lines:
    """Write the worst answer of each kind, in cycles of 1 s and of 0.1 s."""
    columns = []
    for cycle_s in (1, 0.1):
        with TemporaryDirectory() as folder:
            settings = {"time.cycle_s": cycle_s}
            run = simulate("commissioning", settings=settings, out=Path(folder) / "run")
            columns.append(run.summary.answers)
    budgets = load_scenario("commissioning").scenario.answers
    yield ["answer", "1 Hz", "10 Hz", "budget"]
    for title, (field, worst, decimals) in ANSWERS.items():
        of_frequency = "frequency" in title
        figures = (
            worst(
                abs(getattr(one, field))
                for one in column
                if getattr(one, field) is not None and (one.asked == "frequency") == of_frequency
            )
            for column in columns
        )
        budget = f"{getattr(budgets, field):g}"
        yield [title, *(f"{figure:.{decimals}f}" for figure in figures), budget]


# docs/clusters.md


def clusterings(name: str, scenario: str | ScenarioFile, settings: dict[str, Any]) -> pd.DataFrame:
    """Compare ways to choose clusters while the central controller acts every 1, 10 and 60 s."""
    loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
    cycle_s = loaded.scenario.time.cycle_s
    periods = [round(period_s / cycle_s) for period_s in (1, 10, 60) if period_s >= cycle_s]
    run = partial(compare, loaded, schemes=["predictive"], actuators=["limit"], workers=WORKERS)
    acting = {"control.period_cycles": [[period, 1] for period in periods], **settings}
    ways = run(settings={"control.clusters": ["correlation", "geographic", "most-alike"], **acting})
    seeds = {"control.clusters": "random", "control.clusters_seed": list(range(1, 21))}
    rows = pd.concat([ways, run(settings=seeds | acting)]).assign(case=name)
    return rows.assign(
        period=[f"{cycles * cycle_s:g} s" for cycles, _ in rows["control.period_cycles"]]
    )


def clusters(cases: Mapping[str, tuple[str | ScenarioFile, dict[str, Any]]]) -> Lines:
    """Write a row for each way to choose clusters, of random ones mean, least and most."""
    tables = [clusterings(name, *case) for name, case in cases.items()]
    periods = list(dict.fromkeys(tables[0]["period"]))
    missed = (f"control-caused %, {period}" for period in periods)
    yield ["sky", "clusters", "help from outside %", "plant able %", *missed]
    for rows in tables:
        for way, group in rows.groupby("control.clusters", sort=False):
            hows = ("mean", "min", "max") if way == "random" else ("mean",)
            for how in hows:
                by_period = group.groupby("period", sort=False)
                always = by_period.get_group(periods[0])
                helped = (always[name].agg(how) for name in ("outside-help", "outside-help-able"))
                caused = by_period["control-caused"].agg(how)
                title = way if how == "mean" else f"{way}, {how}"
                yield [
                    *(rows["case"].iloc[0], title),
                    *(f"{percent:.1f}" for percent in helped),
                    *(f"{caused[period]:.3f}" for period in periods),
                ]


def learned(data: Path) -> Lines:
    """Write what clusters learned in half an hour are worth after it, beside those of hindsight."""
    yield ["sky", "minutes judged", "clusters", "help from outside %", "plant able %"]
    for sky, (scenario, settings) in skies_of(data).items():
        day = prepare(with_settings(scenario, [*settings.items()]), RunOptions(), "learned")
        (run,) = run_scheme("predictive", day.plan, day.profile, "limit")
        learns, mpp_kw = round(1800.0 / day.plan.timing.cycle_s), day.profile.mpp_kw
        sizes = [*Counter(leaf.split("/")[0] for leaf in day.plan.tree.leaves).values()]
        ways = {
            "learned": search_clusters(correlation_of(mpp_kw[:learns]), sizes),
            "hindsight": search_clusters(correlation_of(mpp_kw), sizes),
            "geographic": geographic_clusters(*np.array(day.plan.site.positions_m).T, sizes),
        }
        later_kw = run.residual_kw[learns:]
        minutes = len(later_kw) * day.plan.timing.cycle_s / 60.0
        needy, able = (later_kw < 0.0).any(axis=1), later_kw.sum(axis=1) >= 0.0
        for way, found in ways.items():
            sums_kw = [later_kw[:, list(members)].sum(axis=1) for members in found]
            outside = np.min(sums_kw, axis=0) < 0.0
            shares = (
                f"{100.0 * outside[cycles].mean():.1f}" if cycles.any() else "-"
                for cycles in (needy, needy & able)
            )
            yield [sky, f"{minutes:.0f}", way, *shares]


def correlation_of(power_kw: Any) -> Any:
    return hourly_correlation(power_kw, np.zeros(len(power_kw), dtype=int))[0]


# docs/delays.md

NETWORK: Final[Columns] = {
    "scheme": ("scheme", None),
    "control-caused": ("control-caused %", 3),
    "over-delivered": ("over-delivered %", 3),
    "mileage": ("mileage kW/h", 0),
    "regd": ("RegD to 1 %", 1),
    "score": ("score", 3),
    "missed-inputs": ("inputs missed", 0),
}
FAULT: Final[Columns] = {"fault": ("fault", None)}


def under(**changes: Any) -> pd.DataFrame:
    """Run the hour of that page."""
    settings = {"commitment.share": 0.6, **changes.pop("settings", {})}
    cases = {"actuators": ["fraction"], "settings": settings, **changes}
    hour_of_clouds = {"start": "12:00", "duration": "1h", "workers": WORKERS}
    return compare("oahu-day", schemes=HIERARCHICAL, **hour_of_clouds, **cases)


def delays() -> Lines:
    rules = ("none", *(f"delay={delay_s:g}s" for delay_s in (0.1, 0.2, 0.5, 1, 2, 5, 10)))
    both = {**FAULT, **CASE, **NETWORK}
    return table(under(faults=rules, actuators=BOTH), both)


def losses() -> Lines:
    rules = ("none", *(f"loss={percent}%" for percent in (1, 5, 10, 20)))
    return table(under(faults=rules), {**FAULT, **NETWORK})


def central_periods() -> Lines:
    periods = [[cycles, 1] for cycles in (1, 2, 5, 10, 30, 60)]
    rows = under(settings={"control.period_cycles": periods})
    return table(rows, {"control.period_cycles": ("period_cycles", None), **NETWORK})


def longer_cycles() -> Lines:
    rows = pd.concat(
        under(faults=[fault], settings={"time.cycle_s": [1, cycle_s]})
        for fault, cycle_s in (("delay=0.2s", 2), ("delay=0.5s", 5))
    )
    return table(rows, {**FAULT, "time.cycle_s": ("cycle [s]", None), **NETWORK})


def batteries(data: Path) -> Lines:
    """Write the smallest battery that covers what is missed; of clouds, the mean of three skies."""
    schemes = ["uniform-cap", "grouping", *HIERARCHICAL]
    run = partial(compare, schemes=schemes, actuators=["limit"], workers=WORKERS)
    shares = {"commitment.share": CELLS["commitment.share"]}
    seeds = [1, 2, 3]
    skies = {name: run(name, settings=shares, seeds=seeds) for name in ("oahu", UTILITY)}
    for sky, (scenario, settings) in skies_of(data).items():
        skies[sky] = run(scenario, settings=shares | settings)
    names = ("battery-power", "battery-energy", "battery-cycles", "battery-mileage")
    of_control = ("control-battery-power", "control-battery-energy")
    units = ("kW", "kWh", "full cycles", "mileage kW/h", "control-caused kW", "control-caused kWh")
    yield ["sky", "promise", "scheme", *units]
    for sky, rows in skies.items():
        for scheme in ("uniform-cap", "grouping median", *HIERARCHICAL):
            of_scheme = rows[rows["scheme"] == scheme].groupby("commitment.share")
            for share, means in of_scheme[[*names, *of_control]].mean().iterrows():
                kw, kwh, cycles, mileage, caused_kw, caused_kwh = means
                figures = (f"{kw:.0f}", f"{kwh:.2f}", f"{cycles:.1f}", f"{mileage:.0f}")
                yield [
                    sky,
                    f"{share:.0%}",
                    scheme,
                    *figures,
                    f"{caused_kw:.0f}",
                    f"{caused_kwh:.2f}",
                ]


# docs/storage.md

PROMISE_DAYS: Final = range(1, 1 + int(os.environ.get("DAYS", "30")))
PROMISE_HOURS: Final = {"start": "08:00", "duration": "8h"}
MINUTES: Final = (0, 5, 15, 60)


def firm_promises() -> Lines:
    """Write what share of clear sky is kept in 95 % of the quarter hours, by the battery."""
    clear = with_settings(
        load_scenario("oahu-day"),
        [("commitment", {"kind": "share-of-clear-sky", "share": 1.0}), ("plant.actuator", "limit")],
    )
    days = [
        prepare(clear, RunOptions(seed=seed, **PROMISE_HOURS), "promise") for seed in PROMISE_DAYS
    ]
    yield ["minutes of battery", "without help %", "with help %"]
    for minutes in MINUTES:
        under = (partial(missed_under, minutes=minutes, has_help=one) for one in (False, True))
        yield [minutes, *(firm_percent(days, missed) for missed in under)]


def firm_percent(days: Sequence[Preparation], missed: Callable[[Preparation, float], Any]) -> int:
    """Return the promise, in % of clear sky, of which enough is there in 95 % of the quarters."""
    kept, lost = 0, 100
    while lost - kept > 1:
        percent = (kept + lost) // 2
        shares_missed = np.concatenate([missed(day, percent / 100.0) for day in days])
        is_kept = np.mean(shares_missed <= MISSED_SHARE) >= 0.95
        kept, lost = (percent, lost) if is_kept else (kept, percent)
    return kept


def stored_offers() -> Lines:
    """Write how often offers were kept by what the plant gave, without and with its battery."""
    days = [offered_run("oahu-storage", "07:00", "10h", seed) for seed in PROMISE_DAYS]
    yield ["actuator", "battery", "intervals", "kept %", "promised %"]
    for actuator, battery in product(BOTH, ("none", "2 MW, 500 kWh")):
        runs = days if battery != "none" else [(replace_fields(p, storages=()), q) for p, q in days]
        powers_kw = promised(runs, OfferedCommitment(lead_s=60.0), actuator)
        offered, _, available, _, given = (kw.reshape(-1, 900) for kw in powers_kw)
        missed = np.maximum(offered - given, 0.0).sum(axis=1) / offered.sum(axis=1)
        kept = f"{100 * np.mean(missed <= MISSED_SHARE):.1f}"
        part = f"{100 * offered.sum() / available.sum():.1f}"
        yield [actuator, battery, len(offered), kept, part]


def hard_promises() -> Lines:
    """Write what is missing of the dispatch where no forecast helps, by the battery."""
    yield ["sky", *(f"{minutes} min" for minutes in MINUTES)]
    for sky, cells in hard_cells().items():
        missed: dict[int, list[float]] = {minutes: [] for minutes in MINUTES}
        for minutes, (plan, profile) in product(MINUTES, cells):
            run = run_loop(with_battery(plan, minutes), profile, "predictive", "limit")
            given_kw = run.power_kw.sum(axis=1) + run.storage_power_kw.sum(axis=1)
            missing_kw = np.maximum(run.dispatch_kw - given_kw, 0.0)
            missed[minutes].append(float(100.0 * missing_kw.sum() / run.dispatch_kw.sum()))
        yield [sky, *(f"{np.mean(percent):.3f}" for percent in missed.values())]


def with_battery(plan: RunPlan, minutes: int) -> RunPlan:
    """Return a plan with a battery of a quarter of its rating, full at first, all of it usable."""
    rating_kw = 0.25 * plan.tree.rating_kw(ROOT)
    battery = StorageSettings(
        name="battery",
        rating_kw=rating_kw,
        capacity_kwh=rating_kw * max(minutes, 1) / 60.0,
        state=1.0,
        target=1.0,
        lowest_state=0.0,
    )
    return replace_fields(plan, storages=(battery,) if minutes else ())


def missed_under(day: Preparation, share: float, minutes: int = 0, *, has_help: bool = True) -> Any:
    """Return which share of its energy is missing of each quarter hour under a promise."""
    plan = with_battery(day.plan, minutes)
    wanted_kw = share * day.profile.commitment_kw
    profile = replace(day.profile, commitment_kw=wanted_kw, regulation_kw=np.zeros_like(wanted_kw))
    run = run_loop(plan, profile, "predictive", "limit", has_help=has_help)
    given_kw = Meters(plan).fed_in_kw(run.power_kw, run.storage_power_kw)
    missing_kw = np.maximum(profile.commitment_kw - given_kw, 0.0)
    quarters = len(given_kw) // 900
    by_quarter = [
        kw[: 900 * quarters].reshape(-1, 900).sum(1) for kw in (missing_kw, profile.commitment_kw)
    ]
    return by_quarter[0] / by_quarter[1]


# docs/fleet.md

LINKS_MS: Final = (50, 200, 1000)
REPORTS: Final = ("impp", "residual")


def fleet_days(places: Sequence[int]) -> list[Preparation]:
    """Return days of some plants of the fleet, without storages, under a clear-sky promise."""
    plants = msgspec.to_builtins(load_scenario("fleet").scenario.plants)
    wanted = {"kind": "share-of-clear-sky", "share": 1.0}
    changes = [("plants", [plants[place] for place in places]), ("commitment", wanted)]
    days = [
        prepare(
            with_settings(load_scenario("fleet"), changes),
            RunOptions(seed=seed + SEEDS_APART * places[0], **PROMISE_HOURS),
            "fleet",
        )
        for seed in PROMISE_DAYS
    ]
    return [replace(day, plan=replace_fields(day.plan, storages=())) for day in days]


def pooling() -> Lines:
    """Write what a fleet needs under the scenario's promise, beside its plants on their own."""
    fleet = load_scenario("fleet").scenario
    names = ("unavoidable-energy", "control-caused-energy", "battery-power", "battery-energy")
    units = ("unavoidable kWh", "control-caused kWh", "battery kW", "battery kWh")
    yield ["plants", "firm promise %", *units]
    every, alone = [*range(len(fleet.plants))], []
    for places in (*([place] for place in every), every):
        days, means = fleet_days(places), []
        for day in days:
            wanted_kw = fleet.commitment.share * day.profile.commitment_kw
            profile = replace(day.profile, commitment_kw=wanted_kw)
            figures = run_figures(run_scheme("predictive", day.plan, profile, "limit")[0])
            means.append([figures[name] for name in names])
        alone.append(np.mean(means, axis=0))
        if places == every:
            yield ["all, each alone", "", *(f"{kw:.1f}" for kw in np.sum(alone[:-1], axis=0))]
        title = "the fleet" if places == every else fleet.plants[places[0]].name
        yield [title, firm_percent(days, missed_under), *(f"{kw:.1f}" for kw in alone[-1])]


def links_between_plants() -> Lines:
    """Write what a slow link between the plants and their controller costs."""
    ways = "source=central,signal=setpoint", *(f"listener=central,signal={s}" for s in REPORTS)
    rules = [";".join(f"{way},delay={delay_ms}ms" for way in ways) for delay_ms in LINKS_MS]
    rows = compare("fleet", schemes=["predictive"], faults=["none", *rules], workers=WORKERS)
    yield ["link ms", "missed %", "control-caused %", "given too much %", "RMSE kW"]
    for delay_ms, run in zip((0, *LINKS_MS), rows.to_dict("records"), strict=True):
        names = ("shortfall", "control-caused", "over-delivered")
        yield [delay_ms, *(f"{run[name]:.3f}" for name in names), f"{run['rmse']:.0f}"]


Tables = dict[str, Callable[[], Lines]]

SYNTHETIC: Final[dict[str, Tables]] = {
    "results.md": {
        "case study": case_study,
        "skies": skies,
        "cycles": cycle_lengths,
        "steps": steps,
        "hard skies": hard_skies,
        "regd": regd,
        "paper here": paper_here,
        "plant meter": plant_meter,
        "realism": realism,
        "utility parts": utility_parts,
    },
    "offers.md": {"offers": offers},
    "storage.md": {
        "firm promise": firm_promises,
        "hard skies": hard_promises,
        "offers": stored_offers,
    },
    "fleet.md": {"pooling": pooling, "links": links_between_plants},
    "orders.md": {"commissioning": commissioning},
    "clusters.md": {
        "oahu": lambda: clusters({"oahu": ("oahu", {})}),
    },
    "delays.md": {
        "delay": delays,
        "loss": losses,
        "period": central_periods,
        "longer cycles": longer_cycles,
    },
}


def measured(data: Path) -> dict[str, Tables]:
    """Return the tables that rest on measurements."""
    plant = real_plant(data)
    return {
        "results.md": {
            "measured skies": partial(measured_skies, data),
            "offsets": partial(offsets, data),
            "intervals": partial(intervals, data),
            "noise": partial(noise, data),
            "stated": partial(stated, data),
            "other skies": partial(other_skies, data),
            "measured unavoidable": partial(measured_unavoidable, data),
            "batteries": partial(batteries, data),
        },
        "offers.md": {"measured offers": partial(measured_offers, data)},
        "clusters.md": {
            "HOPE": lambda: clusters({"HOPE": (hope(data), {})}),
            "learned": partial(learned, data),
            "plant": lambda: clusters({f"hour {name}": (plant, hour(name)) for name in "ac"}),
        },
    }


def default_hour() -> Found:
    (hour,) = compare("oahu", schemes=["predictive"]).to_dict("records")
    yield "hour curtailed", f"{hour['curtailed']:.1f}", "% of the available energy"
    yield "hour missed", f"{hour['shortfall']:.3f}", "% of the dispatched energy"


def main() -> None:
    """Measure the tables, and write each into its document when it is done."""
    words = sys.argv[1:]
    pages = [word for word in words if word.endswith(".md")] or list(SYNTHETIC)
    data = next((Path(word) for word in words if Path(word).is_dir()), None)
    named = {word for word in words if word not in pages and Path(word) != data}
    if not named:
        keep("heliarch compare oahu --schemes predictive", default_hour())
    for page in pages:
        tables = SYNTHETIC[page] | (measured(data).get(page, {}) if data else {})
        for name, lines in tables.items():
            word = name.replace(" ", "-")
            if named and word not in named:
                continue
            began = time.monotonic()
            write(f"{page.removesuffix('.md')}-{word}", lines())
            fill()
            print(f"{page}, {name}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
