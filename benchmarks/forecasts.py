"""What the constants of the `predictive` scheme are worth, in the whole hierarchy.

    .venv/bin/python benchmarks/forecasts.py DATA

with the folder that holds `hope-melpitz-1s` and `plant20mw-combiners-10s`; it takes some minutes.
The tables have the worst of each day's commitments, 50 and 90 % of the median, with and without
meter noise, in % of the commitment. Decision 6 has them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import get_args

from msgspec.structs import replace

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

FIRST = {"DAMPING": 0.9, "TREND_TIME_S": 0.1, "SMALL_ERROR": 0.0, "MARGIN": 0.4}
"""Constants of the first edition."""

LAWS: dict[str, Law] = {
    "the paper": ("paper", {}),
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


def worst_cell(runs: list[Preparation], law: Law, actuator: Actuator) -> Figures:
    scheme, constants = law
    percents = []
    for run in runs:
        profile = run.profile
        plan = replace(run.plan, scheme=scheme, correction=scheme == "predictive")
        power_kw = run_loop(plan, profile, scheme, actuator, constants).power_kw.sum(axis=1)
        possible_kw, cycle_s = profile.mpp_kw.sum(axis=1), plan.cycle_ns / 1e9
        energy = commitment_metrics(profile.commitment_kw, possible_kw, power_kw, cycle_s)
        percent = 100.0 / energy.desired_kwh
        percents.append((percent * energy.control_caused_kwh, percent * energy.over_delivered_kwh))
    caused, beyond = map(max, zip(*percents, strict=True))
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


def main() -> None:
    days = known_days(Path(sys.argv[1]))
    for actuator in get_args(Actuator):
        print(f"\n{actuator} actuator: shortfall (over-delivery) in the worst cell")
        for name, law in LAWS.items():
            cells = (worst_cell(runs, law, actuator) for runs in days.values())
            texts = (f"{caused:.3f} ({beyond:.2f})" for caused, beyond in cells)
            pairs = zip(days, texts, strict=True)
            print(f"{name:32}" + "".join(f"  {day} {text}" for day, text in pairs))


if __name__ == "__main__":
    main()
