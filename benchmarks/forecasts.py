"""Which forecast of an inverter's maximum, and what to assume of one that is hidden.

    .venv/bin/python benchmarks/forecasts.py DATA

with the folder that holds `hope-melpitz-1s` and `plant20mw-combiners-10s`. The first table sets
forecasts beside each other at equal over-delivery: each is given the margin with which the plant
delivers as much too much as under the paper's rule, so that a margin buys nothing for free. The
plant is one flat cluster with the fraction actuator. The second table is the whole hierarchy with
the limit actuator. Both give control-caused shortfalls in % of the commitment.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.control.forecast import ERROR_MEMORY_S
from agents.plan import Scheme
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.arrays.closed_loop import run_loop
from studies.compare.cases import cases, parse_setting
from studies.metrics import commitment_metrics

Floats = NDArray[np.float64]


def last_value(measured: Floats) -> Floats:
    """What was measured in the cycle before."""
    return np.concatenate([measured[:1], measured[:-1]])


def trend(measured: Floats, damping: float) -> Floats:
    """The last value and a share of its last change."""
    last = last_value(measured)
    return last + damping * (last - last_value(last))


def autoregression(measured: Floats, order: int) -> Floats:
    """Changes regressed on the changes before, learned on line, forgetting in 300 cycles."""
    cycles, count = measured.shape
    change = np.diff(measured, axis=0, prepend=measured[:1])
    square = np.repeat(np.eye(order)[None], count, axis=0)
    product = np.zeros((count, order, 1))
    found = last_value(measured)
    for cycle in range(order + 1, cycles):
        before = change[cycle - order : cycle][::-1].T[:, :, None]
        weight = np.linalg.solve(square + 10.0 * np.eye(order), product)
        found[cycle] += (weight * before).sum(axis=(1, 2))
        square = (1.0 - 1.0 / 300.0) * square + before * before.transpose(0, 2, 1)
        product = (1.0 - 1.0 / 300.0) * product + before * change[cycle][:, None, None]
    return found


def holt(measured: Floats, level_gain: float, trend_gain: float) -> Floats:
    """Double exponential smoothing."""
    level, slope = measured[0].copy(), np.zeros_like(measured[0])
    found = np.empty_like(measured)
    for cycle, value in enumerate(measured):
        found[cycle] = level + slope
        new_level = level_gain * value + (1.0 - level_gain) * found[cycle]
        slope = trend_gain * (new_level - level) + (1.0 - trend_gain) * slope
        level = new_level
    return found


FORECASTS: dict[str, Callable[[Floats], Floats]] = {
    "last value (the paper)": last_value,
    "trend, damping 0.5": lambda measured: trend(measured, 0.5),
    "trend, damping 0.8": lambda measured: trend(measured, 0.8),
    "trend, damping 0.9": lambda measured: trend(measured, 0.9),
    "trend, damping 1": lambda measured: trend(measured, 1.0),
    "autoregression of order 1": lambda measured: autoregression(measured, 1),
    "autoregression of order 2": lambda measured: autoregression(measured, 2),
    "autoregression of order 3": lambda measured: autoregression(measured, 3),
    "Holt, gains 0.9 and 0.9": lambda measured: holt(measured, 0.9, 0.9),
    "Holt, gains 0.8 and 0.6": lambda measured: holt(measured, 0.8, 0.6),
}

Rule = tuple[Scheme, dict[str, float]]
"""A scheme, and other values of constants of its forecast."""

HIDDEN: dict[str, Rule] = {
    "P / alpha (the paper)": ("paper", {}),
    "stays what was last seen": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.0}),
    "grows 1 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.01}),
    "grows 2 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.02}),
    "grows 5 % a second": ("predictive", {"HIDDEN_GROWTH_PER_S": 0.05}),
    "is the rating": ("predictive", {"HIDDEN_GROWTH_PER_S": 1e9}),
}


def behind_limits(day: Preparation, rule: Rule) -> Floats:
    """Power of the plant under a rule, with the limit actuator and without a correction."""
    scheme, constants = rule
    plan = replace(day.plan, scheme=scheme, correction=False)
    power_kw = run_loop(plan, day.profile, scheme, "limit", constants).power_kw
    return np.asarray(power_kw.sum(axis=1))


def mean_error(error: Floats, cycle_s: float) -> Floats:
    """Mean absolute error as a direct controller knows it in each cycle."""
    found = np.empty_like(error)
    mean = np.zeros_like(error[0])
    for cycle, value in enumerate(error):
        found[cycle] = mean
        mean = mean + (value - mean) * cycle_s / (ERROR_MEMORY_S + cycle_s)
    return found


def delivered(day: Preparation, impp: Floats) -> Floats:
    """Power of one flat cluster of equal inverters that believes in these maxima."""
    ranked = np.sort(impp, axis=1)
    below = np.cumsum(ranked, axis=1) - ranked
    left = np.arange(ranked.shape[1], 0, -1)
    level = (day.profile.commitment_kw[:, None] - below) / left
    first = np.argmax(level <= ranked, axis=1)
    found = np.where((level <= ranked).any(axis=1), level[np.arange(len(level)), first], np.inf)
    alpha = np.minimum(found[:, None], impp) / np.maximum(impp, 1e-9)
    return np.asarray((np.clip(alpha, day.plan.alpha_min, 1.0) * day.profile.mpp_kw).sum(axis=1))


def percent(day: Preparation, power: Floats) -> tuple[float, float]:
    """Control-caused shortfall and over-delivery, % of the commitment."""
    profile = day.profile
    energy = commitment_metrics(
        list(profile.commitment_kw), list(profile.mpp_kw.sum(axis=1)), list(power), 1.0
    )
    in_percent = 100.0 / energy.desired_kwh
    return in_percent * energy.control_caused_kwh, in_percent * energy.over_delivered_kwh


def at_equal_over_delivery(day: Preparation, forecast: Callable[[Floats], Floats]) -> float:
    """Shortfall with the margin that delivers as much too much as the paper's rule does."""
    measured = day.profile.mpp_kw * (1.0 + day.profile.meter_error)
    rating = day.plan.tree.rating_kw(day.plan.tree.leaves[0])
    allowed = percent(day, delivered(day, last_value(measured)))[1]
    expected = np.clip(forecast(measured), 0.0, rating)
    spread = mean_error(np.abs(measured - expected), day.plan.cycle_ns / 1e9)

    def with_margin(margin: float) -> tuple[float, float]:
        return percent(day, delivered(day, np.maximum(expected - margin * spread, 0.0)))

    low, high = 0.0, 5.0
    for _ in range(12):
        middle = (low + high) / 2.0
        low, high = (low, middle) if with_margin(middle)[1] > allowed else (middle, high)
    return with_margin(low)[0]


def days(data: Path) -> dict[str, Preparation]:
    """The days of the tables."""
    found = {}
    for name, scenario, folder, words in (
        ("HOPE", "hope-melpitz", "hope-melpitz-1s", ()),
        ("hour a", "plant20mw", "plant20mw-combiners-10s", ()),
        (
            "hour c",
            "plant20mw",
            "plant20mw-combiners-10s",
            ("irradiance.currents=hour_c.csv",),
        ),
    ):
        file = load_scenario(scenario, data / folder)
        settings = [
            parse_setting("commitment.share=0.5,0.9"),
            parse_setting("plant.meter_noise=0,0.005"),
            *(parse_setting(word) for word in words),
        ]
        for case in cases(file, RunOptions(), settings):
            label = case.label.replace(" currents=hour_c.csv", "").replace("meter_", "")
            found[f"{name} {label}"] = prepare(case.scenario, case.options, "forecasts")
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


def largest_over_delivery(day: Preparation, rule: Rule) -> float:
    """Largest power beyond what was desired [kW]."""
    desired = day.profile.commitment_kw + day.profile.regulation_kw
    return float((behind_limits(day, rule) - desired).max())


def table(title: str, names: list[str], rows: dict[str, list[float]]) -> None:
    sys.stdout.write(f"\n{title}\n")
    for number, name in enumerate(names, start=1):
        sys.stdout.write(f"  ({number}) {name}\n")
    head = "".join(f"{f'({number})':>8}" for number in range(1, len(names) + 1))
    sys.stdout.write(f"{'':28}{head}\n")
    for name, values in rows.items():
        sys.stdout.write(f"{name:28}{''.join(f'{value:8.3f}' for value in values)}\n")


def main() -> None:
    known = days(Path(sys.argv[1]))
    forecasts = {
        name: [at_equal_over_delivery(day, forecast) for day in known.values()]
        for name, forecast in FORECASTS.items()
    }
    table("fraction actuator, at the over-delivery of the paper's rule", list(known), forecasts)
    hidden = {
        name: [percent(day, behind_limits(day, rule))[0] for day in known.values()]
        for name, rule in HIDDEN.items()
    }
    table("limit actuator: what is assumed of a hidden maximum", list(known), hidden)
    morning = clear_morning()
    highest = {name: [largest_over_delivery(morning, rule)] for name, rule in HIDDEN.items()}
    table(
        "limit actuator, a clear morning: largest over-delivery of a cycle, kW",
        ["oahu-day without clouds, 6:30 to 12:30"],
        highest,
    )


if __name__ == "__main__":
    main()
