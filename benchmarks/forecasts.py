"""Which forecast of an inverter's maximum, which margin, and what to assume of a hidden one.

    .venv/bin/python benchmarks/forecasts.py DATA

with the folder that holds `hope-melpitz-1s` and `plant20mw-combiners-10s`; it takes some minutes.
All tables are for commitments of 50 and 90 % of the median, with and without meter noise; figures
are in % of the commitment.

1. Forecasts at equal over-delivery: each is given the margin with which the plant delivers as much
   too much as under the paper's rule, so that a margin buys nothing for free. Control-caused
   shortfall.
2. Margins at equal shortfall: each is made as large as it takes to miss 0.05 %. Over-delivery.
3. Constants of the control law in the whole hierarchy: the worst cell of each day.
4. Assumptions about a maximum behind a limit, in the whole hierarchy. Control-caused shortfall.

In 1 and 2 the plant is one flat cluster with the fraction actuator.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.control.forecast import DAMPING, ERROR_MEMORY_S, SMALL_ERROR, TREND_TIME_S
from agents.plan import Actuator, Scheme
from launch_scripts.scenarios.power_sources import power_source
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from sim_plant.positions import east_north_m
from studies.arrays.closed_loop import run_loop
from studies.compare.cases import cases, parse_setting
from studies.metrics import commitment_metrics

Floats = NDArray[np.float64]
Figures = tuple[float, float]
"""Control-caused shortfall and over-delivery, % of the commitment."""

ENOUGH = 0.05
"""Control-caused shortfall that the second table allows, % of the commitment."""


@dataclass(frozen=True)
class Day:
    """A run, and what its controllers could know in each of its cycles.

    Attributes
    ----------
    measured
        Maximum of the interval that ended, with the meter's error, shape (cycles, inverters).
    position_m
        East and north of each inverter, shape (inverters, 2).
    """

    run: Preparation
    measured: Floats
    position_m: Floats

    @property
    def cycle_s(self) -> float:
        return self.run.plan.cycle_ns / 1e9

    @property
    def rating_kw(self) -> float:
        return self.run.plan.tree.rating_kw(self.run.plan.tree.leaves[0])

    @property
    def commitment_kw(self) -> Floats:
        return self.run.profile.commitment_kw

    @property
    def mpp_kw(self) -> Floats:
        return self.run.profile.mpp_kw


# Forecasts ----------------------------------------------------------------------------------------


def before(values: Floats, cycles: int = 1) -> Floats:
    """The values of so many cycles earlier."""
    return np.concatenate([values[:1]] * cycles + [values[: len(values) - cycles]])


def trend(damping: float, time_s: float = 0.0) -> Callable[[Day], Floats]:
    """The last value and a share of its smoothed change."""

    def forecast(day: Day) -> Floats:
        change = day.measured - before(day.measured)
        return day.measured + damping * smoothed(change, time_s, day.cycle_s)

    return forecast


def smoothed(values: Floats, time_s: float, cycle_s: float) -> Floats:
    """Exponential mean, from zero on."""
    found, mean = np.empty_like(values), np.zeros_like(values[0])
    for cycle, value in enumerate(values):
        mean = mean + (value - mean) * cycle_s / (time_s + cycle_s)
        found[cycle] = mean
    return found


def autoregression(order: int) -> Callable[[Day], Floats]:
    """Changes regressed on the changes before, learned on line, forgetting in 300 cycles."""

    def forecast(day: Day) -> Floats:
        cycles, count = day.measured.shape
        change = np.diff(day.measured, axis=0, prepend=day.measured[:1])
        square = np.repeat(np.eye(order)[None], count, axis=0)
        product_ = np.zeros((count, order, 1))
        found = day.measured.copy()
        for cycle in range(order, cycles):
            recent = change[cycle - order + 1 : cycle + 1][::-1].T[:, :, None]
            weight = np.linalg.solve(square + 10.0 * np.eye(order), product_)
            found[cycle] += (weight * recent).sum(axis=(1, 2))
            if cycle + 1 < cycles:
                square = (1.0 - 1.0 / 300.0) * square + recent * recent.transpose(0, 2, 1)
                product_ = (1.0 - 1.0 / 300.0) * product_
                product_ = product_ + recent * change[cycle + 1][:, None, None]
        return found

    return forecast


def holt(level_gain: float, trend_gain: float) -> Callable[[Day], Floats]:
    """Double exponential smoothing."""

    def forecast(day: Day) -> Floats:
        level, slope = day.measured[0].copy(), np.zeros_like(day.measured[0])
        found = np.empty_like(day.measured)
        for cycle, value in enumerate(day.measured):
            expected = level + slope
            new_level = level_gain * value + (1.0 - level_gain) * expected
            slope = trend_gain * (new_level - level) + (1.0 - trend_gain) * slope
            level = new_level
            found[cycle] = level + slope
        return found

    return forecast


SPEEDS_M_S = (3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 25.0)
DIRECTIONS = 12
CLOUD_LENGTH_M, CLOUD_LIFE_S = 1500.0, 100.0
WIND_MEMORY_S = 300.0


def upwind(day: Day) -> Floats:
    """Kriging of all inverters' last two readings in the frame of the moving clouds.

    Of many wind speeds and directions that which has been best in the last minutes counts.
    """
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    winds = [np.zeros(2)]
    winds += [s * np.array([np.cos(a), np.sin(a)]) for s, a in product(SPEEDS_M_S, angles)]
    readings = np.hstack([day.measured, before(day.measured)])
    found = np.stack([readings @ kriging(day, wind).T for wind in winds])
    found = np.clip(found, 0.0, day.rating_kw)
    error = np.stack([((day.measured - before(each)) ** 2).sum(axis=1) for each in found], axis=1)
    best = smoothed(error, WIND_MEMORY_S, day.cycle_s).argmin(axis=1)
    return np.asarray(found[best, np.arange(len(best))])


def kriging(day: Day, wind_m_s: Floats) -> Floats:
    """Weights of the readings of all inverters now and a cycle ago, shape (n, 2 n)."""
    count = len(day.position_m)
    place = np.concatenate([day.position_m] * 3)
    time_s = np.repeat([0.0, -day.cycle_s, day.cycle_s], count)
    apart_s = time_s[:, None] - time_s
    apart_m = place[:, None] - place - apart_s[..., None] * wind_m_s
    distance = np.linalg.norm(apart_m, axis=2) / CLOUD_LENGTH_M + np.abs(apart_s) / CLOUD_LIFE_S
    alike, known = np.exp(-distance), 2 * count
    system = np.ones((known + 1, known + 1))
    system[:known, :known] = alike[:known, :known] + 1e-3 * np.eye(known)
    system[known, known] = 0.0
    wanted = np.vstack([alike[:known, known:], np.ones((1, count))])
    return np.asarray(np.linalg.solve(system, wanted)[:known].T)


def upwind_and_trend(day: Day) -> Floats:
    """Both, each inverter's weighted by their errors of the last minutes."""
    both = np.stack([our_trend(day), upwind(day)])
    error = [
        smoothed((day.measured - before(one)) ** 2, WIND_MEMORY_S, day.cycle_s) for one in both
    ]
    weight = 1.0 / (np.stack(error) + 1e-6)
    return np.asarray((weight * both).sum(axis=0) / weight.sum(axis=0))


our_trend = trend(DAMPING, TREND_TIME_S)

FORECASTS: dict[str, Callable[[Day], Floats]] = {
    "last value (the paper)": lambda day: day.measured,
    "trend, damping 0.5": trend(0.5),
    "trend, damping 0.8": trend(0.8),
    "trend, damping 0.9": trend(0.9),
    "trend, damping 1": trend(1.0),
    "trend of 0.5 s, damping 0.8": our_trend,
    "autoregression of order 1": autoregression(1),
    "autoregression of order 2": autoregression(2),
    "Holt, gains 0.9 and 0.9": holt(0.9, 0.9),
    "Holt, gains 0.8 and 0.6": holt(0.8, 0.6),
    "upwind": upwind,
    "upwind and trend": upwind_and_trend,
}


# Margins ------------------------------------------------------------------------------------------

Margin = Callable[[Day, Floats, float], Floats]
"""The power that an IMPP is reported with, from the forecast and the size of the margin."""


def errors(day: Day, expected: Floats) -> Floats:
    """By how much each forecast that has come due was too high."""
    return before(expected) - day.measured


def share_of_mean_error(small: float) -> Margin:
    """A share of the own mean error beyond a small one."""

    def reported(day: Day, expected: Floats, size: float) -> Floats:
        spread = smoothed(np.abs(errors(day, expected)), ERROR_MEMORY_S, day.cycle_s)
        return expected - size * np.maximum(spread - small * day.rating_kw, 0.0)

    return reported


def learned_quantile(day: Day, expected: Floats, size: float) -> Floats:
    """The quantile of the own errors that belongs to a share of 1 - exp(-size)."""
    quantile, share = np.zeros_like(expected[0]), 1.0 - np.exp(-size)
    spread = smoothed(np.abs(errors(day, expected)), ERROR_MEMORY_S, day.cycle_s)
    found = np.empty_like(expected)
    for cycle, error in enumerate(errors(day, expected)):
        quantile = quantile + 0.1 * spread[cycle] * ((error > quantile) - (1.0 - share))
        found[cycle] = expected[cycle] - quantile
    return found


def margin_of_the_plant(day: Day, expected: Floats, size: float) -> Floats:
    """A share of the mean error of the plant's sum, divided among its inverters."""
    error = np.abs(errors(day, expected).sum(axis=1, keepdims=True))
    spread = smoothed(error, 3.0 * ERROR_MEMORY_S, day.cycle_s)
    plant = np.maximum(expected.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(expected * (1.0 - size * spread / plant))


Shares = Literal["rating", "IMPP"]
Rule = tuple[Callable[[Day], Floats], Margin, Shares]

MARGINS: dict[str, Rule] = {
    "last value, mean error": (lambda day: day.measured, share_of_mean_error(0.0), "rating"),
    "trend, mean error": (our_trend, share_of_mean_error(0.0), "rating"),
    "trend, beyond small errors": (our_trend, share_of_mean_error(SMALL_ERROR), "rating"),
    "trend, learned quantile": (our_trend, learned_quantile, "rating"),
    "trend, error of the plant": (our_trend, margin_of_the_plant, "rating"),
    "trend, shares by IMPP": (our_trend, share_of_mean_error(SMALL_ERROR), "IMPP"),
    "upwind and trend": (upwind_and_trend, share_of_mean_error(SMALL_ERROR), "rating"),
}


def delivered(day: Day, impp: Floats, shares: Shares = "rating") -> Floats:
    """Power of one flat cluster of equal inverters that believes in these maxima."""
    impp = np.maximum(impp, 0.0)
    if shares == "IMPP":
        alpha = day.commitment_kw[:, None] / np.maximum(impp.sum(axis=1, keepdims=True), 1e-9)
    else:
        ranked = np.sort(impp, axis=1)
        below = np.cumsum(ranked, axis=1) - ranked
        left = np.arange(ranked.shape[1], 0, -1)
        level = (day.commitment_kw[:, None] - below) / left
        first = np.argmax(level <= ranked, axis=1)
        found = np.where((level <= ranked).any(axis=1), level[np.arange(len(level)), first], np.inf)
        alpha = np.where(impp > 0.0, found[:, None] / np.maximum(impp, 1e-9), 1.0)
    return np.asarray((np.clip(alpha, day.run.plan.alpha_min, 1.0) * day.mpp_kw).sum(axis=1))


def figures(day: Day, power: Floats) -> Figures:
    possible = day.mpp_kw.sum(axis=1)
    energy = commitment_metrics(day.commitment_kw, possible, power, day.cycle_s)
    in_percent = 100.0 / energy.desired_kwh
    return in_percent * energy.control_caused_kwh, in_percent * energy.over_delivered_kwh


def forecast_of(day: Day, forecast: Callable[[Day], Floats]) -> Floats:
    return np.clip(forecast(day), 0.0, day.rating_kw)


def largest_without(too_much: Callable[[float], bool]) -> float:
    """The largest size from 0 to 8 that is not too much."""
    low, high = 0.0, 8.0
    for _ in range(14):
        middle = (low + high) / 2.0
        low, high = (low, middle) if too_much(middle) else (middle, high)
    return low


def at_equal_over_delivery(day: Day, forecast: Callable[[Day], Floats]) -> float:
    """Shortfall with the margin that delivers as much too much as the paper's rule does."""
    expected = forecast_of(day, forecast)
    margin = share_of_mean_error(0.0)
    allowed = figures(day, delivered(day, day.measured))[1]

    def with_margin(size: float) -> Figures:
        return figures(day, delivered(day, margin(day, expected, size)))

    return with_margin(largest_without(lambda size: with_margin(size)[1] > allowed))[0]


def at_equal_shortfall(day: Day, rule: Rule) -> float:
    """Over-delivery with the least margin that misses no more than `ENOUGH`."""
    forecast, margin, shares = rule
    expected = forecast_of(day, forecast)

    def with_margin(size: float) -> Figures:
        return figures(day, delivered(day, margin(day, expected, size), shares))

    return with_margin(largest_without(lambda size: with_margin(size)[0] <= ENOUGH))[1]


# The whole hierarchy ------------------------------------------------------------------------------

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


def plant_kw(run: Preparation, law: Law, actuator: Actuator, *, correction: bool = False) -> Floats:
    """Power of the plant under a law."""
    scheme, constants = law
    plan = replace(run.plan, scheme=scheme, correction=correction)
    return np.asarray(run_loop(plan, run.profile, scheme, actuator, constants).power_kw.sum(axis=1))


def worst_cell(days: list[Day], law: Law, actuator: Actuator) -> Figures:
    """Largest shortfall of some days, and largest over-delivery."""
    correction = law[0] == "predictive"
    found = [figures(day, plant_kw(day.run, law, actuator, correction=correction)) for day in days]
    return max(each[0] for each in found), max(each[1] for each in found)


def known_days(data: Path) -> dict[str, Day]:
    """The days of the tables."""
    found = {}
    for name, scenario, folder, words in (
        ("HOPE", "hope-melpitz", "hope-melpitz-1s", ()),
        *(
            (f"hour {hour}", "plant20mw", "plant20mw-combiners-10s", (f"hour_{hour}.csv",))
            for hour in "abc"
        ),
    ):
        settings = [
            parse_setting("commitment.share=0.5,0.9"),
            parse_setting("plant.meter_noise=0,0.005"),
            *(parse_setting(f"irradiance.currents={word}") for word in words),
        ]
        for case in cases(load_scenario(scenario, data / folder), RunOptions(), settings):
            run = prepare(case.scenario, case.options, "forecasts")
            label = f"{name} {case.label}".partition(" currents")[0]
            found[label] = Day(
                run,
                np.minimum(
                    before(run.profile.mpp_kw) * (1.0 + run.profile.meter_error),
                    run.plan.tree.rating_kw(run.plan.tree.leaves[0]),
                ),
                positions_m(run),
            )
    return found


def positions_m(run: Preparation) -> Floats:
    times = pd.DatetimeIndex([pd.Timestamp(run.plan.start_time_ns, tz="UTC")])
    sites = power_source(run.scenario, None, times).sites
    place = np.stack(east_north_m(sites.lat_deg, sites.lon_deg), axis=1)
    names = [leaf.rpartition("/")[2] for leaf in run.plan.tree.leaves]
    return place[[sites.names.index(name) for name in names]]


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


def largest_over_delivery(run: Preparation, law: Law) -> float:
    """Largest power beyond what was desired [kW], without a correction."""
    desired = run.profile.commitment_kw + run.profile.regulation_kw
    return float((plant_kw(run, law, "limit") - desired).max())


# Tables -------------------------------------------------------------------------------------------


def table(title: str, names: list[str], rows: dict[str, list[float]]) -> None:
    sys.stdout.write(f"\n{title}\n")
    for number, name in enumerate(names, start=1):
        sys.stdout.write(f"  ({number}) {name}\n")
    head = "".join(f"{f'({number})':>7}" for number in range(1, len(names) + 1))
    sys.stdout.write(f"{'':30}{head}\n")
    for name, values in rows.items():
        sys.stdout.write(f"{name:30}{''.join(f'{value:7.3f}' for value in values)}\n")


def main() -> None:
    known = known_days(Path(sys.argv[1]))
    names, days = list(known), list(known.values())
    table(
        "1. fraction actuator: shortfall at the over-delivery of the paper's rule",
        names,
        {
            name: [at_equal_over_delivery(day, forecast) for day in days]
            for name, forecast in FORECASTS.items()
        },
    )
    paper = {"the paper's rule, as it is": [figures(d, delivered(d, d.measured))[1] for d in days]}
    table(
        f"2. fraction actuator: over-delivery at a shortfall of {ENOUGH} %",
        names,
        paper
        | {name: [at_equal_shortfall(day, rule) for day in days] for name, rule in MARGINS.items()},
    )
    for actuator in ("fraction", "limit"):
        sys.stdout.write(f"\n3. {actuator} actuator: shortfall (over-delivery) in the worst cell\n")
        for name, law in LAWS.items():
            sys.stdout.write(f"{name:32}")
            for hour in ("HOPE", "hour a", "hour b", "hour c"):
                own = [day for label, day in known.items() if label.startswith(hour)]
                caused, beyond = worst_cell(own, law, actuator)
                sys.stdout.write(f"  {hour} {caused:.3f} ({beyond:.2f})")
            sys.stdout.write("\n")
    hidden = {
        name: [figures(day, plant_kw(day.run, law, "limit"))[0] for day in days]
        for name, law in HIDDEN.items()
    }
    table("4. limit actuator: what is assumed of a hidden maximum", names, hidden)
    morning = clear_morning()
    table(
        "limit actuator, a clear morning: largest over-delivery of a cycle, kW",
        ["oahu-day without clouds, 6:30 to 12:30"],
        {name: [largest_over_delivery(morning, law)] for name, law in HIDDEN.items()},
    )


if __name__ == "__main__":
    main()
