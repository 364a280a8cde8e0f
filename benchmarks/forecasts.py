"""What the constants of the `predictive` scheme are worth, in the whole hierarchy.

    .venv/bin/python benchmarks/forecasts.py DATA

with the folder that holds `hope-melpitz-1s` and `plant20mw-combiners-10s`; it takes some minutes.
All tables are for commitments of 50 and 90 % of the median, with and without meter noise; figures
are in % of the commitment. First other constants of the control law, in the worst cell of each day;
then assumptions about a maximum behind a limit. Decision 6 has both.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.settings import Actuator, Scheme
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.arrays.closed_loop import run_loop
from studies.compare.cases import cases, parse_setting
from studies.metrics import commitment_metrics

Figures = tuple[float, float]
"""Control-caused shortfall and over-delivery, % of the commitment."""

Law = tuple[Scheme, dict[str, float]]
"""A scheme, and other values of constants of the control law."""

PAPER: Law = ("paper", {})
FIRST = {"DAMPING": 0.9, "TREND_TIME_S": 0.1, "SMALL_ERROR": 0.0, "MARGIN": 0.4}
"""Constants of the first edition."""

LAWS: dict[str, Law] = {
    "the paper": PAPER,
    "first edition": ("predictive", {**FIRST, "HIGHEST_GAIN": 0.5}),
    "today": ("predictive", {}),
    "damping 0.9, trend of 0.1 s": ("predictive", {"DAMPING": 0.9, "TREND_TIME_S": 0.1}),
    "small error 0": ("predictive", {"SMALL_ERROR": 0.0}),
    "small error 0.6 %": ("predictive", {"SMALL_ERROR": 0.006}),
    "margin 0": ("predictive", {"MARGIN": 0.0}),
    "margin 0.25": ("predictive", {"MARGIN": 0.25}),
    "margin 1": ("predictive", {"MARGIN": 1.0}),
    "margin 2": ("predictive", {"MARGIN": 2.0}),
    "growth 0.3 %": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.003}),
    "correction, gain at once 0.5": ("predictive", {"HIGHEST_GAIN": 0.5}),
    "correction, gain at once 1": ("predictive", {"HIGHEST_GAIN": 1.0}),
    "no correction": ("predictive", {"HIGHEST_CORRECTION": 0.0}),
    "nothing learned of low meters": ("predictive", {"LOW_READING": 0.0}),
}

HIDDEN: dict[str, Law] = {
    "P / alpha (the paper)": PAPER,
    "stays what was last seen": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.0}),
    "grows 1 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.01}),
    "grows 2 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.02}),
    "grows 5 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.05}),
    "is the rating": ("predictive", {"HIDDEN_GROWTH_PER_S": 1e9}),
}


def plant_kw(
    run: Preparation, law: Law, actuator: Actuator, *, correction: bool = False
) -> NDArray[np.float64]:
    scheme, constants = law
    plan = replace(run.plan, scheme=scheme, correction=correction)
    return np.asarray(run_loop(plan, run.profile, scheme, actuator, constants).power_kw.sum(axis=1))


def figures(run: Preparation, power_kw: NDArray[np.float64]) -> Figures:
    possible_kw = run.profile.mpp_kw.sum(axis=1)
    cycle_s = run.plan.cycle_ns / 1e9
    energy = commitment_metrics(run.profile.commitment_kw, possible_kw, power_kw, cycle_s)
    in_percent = 100.0 / energy.desired_kwh
    return in_percent * energy.control_caused_kwh, in_percent * energy.over_delivered_kwh


def worst_cell(runs: list[Preparation], law: Law, actuator: Actuator) -> Figures:
    correction = law[0] == "predictive"
    found = [figures(run, plant_kw(run, law, actuator, correction=correction)) for run in runs]
    caused, beyond = map(max, zip(*found, strict=True))
    return caused, beyond


def known_days(data: Path) -> dict[str, list[Preparation]]:
    """The runs of each day: by share and noise."""
    plant = ("plant20mw", "plant20mw-combiners-10s")
    days: dict[str, tuple[str, str, tuple[str, ...]]] = {
        "HOPE": ("hope-melpitz", "hope-melpitz-1s", ()),
        **{f"hour {a}": (*plant, (f"irradiance.currents=hour_{a}.csv",)) for a in "abc"},
    }
    found = {}
    for name, (scenario, folder, words) in days.items():
        cells = ("commitment.share=0.5,0.9", "plant.meter_noise=0,0.005", *words)
        settings = [parse_setting(word) for word in cells]
        of_day = cases(load_scenario(scenario, data / folder), RunOptions(), settings)
        found[name] = [prepare(case.scenario, case.options, "forecasts") for case in of_day]
    return found


def clear_morning() -> Preparation:
    """A rising sun behind limits: nothing shows by itself how much there is."""
    words = (
        "irradiance.clouds.cloud_cover=0",
        'commitment={kind="share-of-clear-sky",share=0.5}',
        "plant.actuator=limit",
    )
    options = RunOptions(start="06:30", duration="6h")
    (case,) = cases(load_scenario("oahu-day"), options, [parse_setting(word) for word in words])
    return prepare(case.scenario, case.options, "morning")


def largest_over_delivery_kw(run: Preparation, law: Law) -> float:
    """Largest power beyond what was desired, without a correction."""
    desired_kw = run.profile.commitment_kw + run.profile.regulation_kw
    return float((plant_kw(run, law, "limit") - desired_kw).max())


def main() -> None:
    days = known_days(Path(sys.argv[1]))
    for actuator in ("fraction", "limit"):
        print(f"\n{actuator} actuator: shortfall (over-delivery) in the worst cell")
        for name, law in LAWS.items():
            cells = (worst_cell(runs, law, actuator) for runs in days.values())
            texts = (f"{caused:.3f} ({beyond:.2f})" for caused, beyond in cells)
            pairs = zip(days, texts, strict=True)
            print(f"{name:32}" + "".join(f"  {day} {text}" for day, text in pairs))
    morning = clear_morning()
    print("\nlimit actuator: what is assumed of a hidden maximum. Shortfall at 50 and 90 %, each")
    print("without and with noise; largest over-delivery of a cycle on a clear morning, kW")
    for name, law in HIDDEN.items():
        print(f"{name:32}", end="")
        for day, runs in days.items():
            caused = (figures(run, plant_kw(run, law, "limit"))[0] for run in runs)
            print(f"  {day}", *(f"{value:.3f}" for value in caused), end="")
        print(f"  morning {largest_over_delivery_kw(morning, law):,.0f}")


if __name__ == "__main__":
    main()
