"""Draws the pictures of README from runs: `make pictures`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib import dates

from docs.shown import read
from heliarch import compare, load_scenario
from recordings.read.series import RunSeries
from scenarios.preparation import prepare
from scenarios.run_options import RunOptions
from scenarios.settings import with_settings
from studies.arrays.schemes import run_scheme

IMAGES: Final = Path(__file__).parent / "images"
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"
GREY, DARK = "#d9dee3", "#37474f"


def ten_minutes(path: Path) -> None:
    """Draw the plant's power in ten cloudy minutes, with and without control."""
    promise = {"kind": "share-of-clear-sky", "share": 0.6}
    scenario = with_settings(load_scenario("oahu"), [("commitment", promise)])
    day = prepare(scenario, RunOptions(start="10:23", duration="10m"), "pictures")
    plan, profile = day.plan, day.profile
    controlled, capped = (
        run_scheme(name, plan, profile, "limit")[0] for name in ("predictive", "uniform-cap")
    )
    times = pd.date_range(
        pd.Timestamp(plan.timing.start_time_ns, tz="UTC").tz_convert(plan.timing.timezone),
        periods=profile.cycles,
        freq=pd.Timedelta(seconds=plan.timing.cycle_s),
    ).tz_localize(None)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), sharey=True, layout="constrained")
    for axes, series, title, colour in (
        (left, capped, "Each inverter held to its share", ORANGE),
        (right, controlled, "Inverters in the sun cover for shaded ones", BLUE),
    ):
        axes.fill_between(times, series.available_kw / 1e3, color=GREY, lw=0, label="available")
        axes.plot(times, series.delivered_kw / 1e3, color=colour, lw=1.8, label="delivered")
        axes.plot(times, series.dispatch_kw / 1e3, color=DARK, lw=1.0, ls="--", label="promised")
        axes.set_title(f"{title}: {missed_percent(series):.2g} % missed", fontsize=11)
        axes.xaxis.set_major_locator(dates.MinuteLocator(interval=2))
        axes.xaxis.set_major_formatter(dates.DateFormatter("%H:%M"))
        axes.set_ylim(2.5, None)
        axes.margins(x=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(loc="lower left", ncols=3, frameon=False, fontsize=9)
    left.set_ylabel("power of the plant [MW]")
    figure.savefig(path, dpi=160)


def promise(path: Path) -> None:
    """Draw shortfall against curtailed energy while the reliability of the promise is turned."""
    offered = {"kind": "offered", "interval_s": 900}
    rows = compare(
        with_settings(load_scenario("oahu-day"), [("commitment", offered)]),
        schemes=["uniform-cap", "predictive"],
        actuators=["limit"],
        seeds=[1, 2],
        start="7:00",
        end="17:00",
        settings={"commitment.reliability": [0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99]},
        workers=2,
    )
    keys = ["scheme", "commitment.reliability"]
    means = rows.groupby(keys)[["shortfall", "curtailed"]].mean()
    figure, axes = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    for scheme, title, colour in (
        ("uniform-cap", "each inverter held to its share", ORANGE),
        ("predictive", "inverters help each other", BLUE),
    ):
        curve = means.loc[scheme]
        axes.plot(curve["curtailed"], curve["shortfall"], "o-", color=colour, ms=4, label=title)
    for reliability, point in means.loc["predictive"].drop(0.98).iterrows():  # There is no room.
        where = (point["curtailed"], point["shortfall"])
        axes.annotate(
            f"{reliability:g}", where, (-4, -10), textcoords="offset points", ha="right", fontsize=8
        )
    axes.set_xlabel("curtailed, % of the available energy")
    axes.set_ylabel("missed, % of the promise")
    axes.set_ylim(0, None)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=160)


def batteries(path: Path) -> None:
    """Draw the battery that `oahu` needs against the promise, from the table of results.md."""
    titles, *cells = read("results-batteries")
    rows = pd.DataFrame(cells, columns=titles).query("sky == 'oahu'")
    rows["promised"] = rows["promise"].str.rstrip("%").astype(float)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for of_what, title, shown in (
        ("kWh", "for the whole shortfall", axes[0]),
        ("control-caused kWh", "for the control-caused shortfall", axes[1]),
    ):
        for scheme, colour, mark in (
            ("grouping median", DARK, "s-"),
            ("uniform-cap", ORANGE, "o-"),
            ("paper", GREEN, "^-"),
            ("predictive", BLUE, "d-"),
        ):
            curve = rows[rows["scheme"] == scheme]
            needed_kwh = curve[of_what].astype(float)
            shown.plot(curve["promised"], needed_kwh, mark, color=colour, label=scheme)
        shown.set_title(title, fontsize=11)
        shown.set_xlabel("promise, % of the clear sky's power")
        shown.set_ylim(0, None)
        shown.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("capacity of the smallest battery [kWh]")
    axes[0].legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=160)


def missed_percent(series: RunSeries) -> float:
    return float(100.0 * series.shortfall_kw.sum() / series.dispatch_kw.sum())


if __name__ == "__main__":
    ten_minutes(IMAGES / "ten-minutes.png")
    promise(IMAGES / "promise.png")
    batteries(IMAGES / "batteries.png")
