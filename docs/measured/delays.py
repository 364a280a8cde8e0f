"""The tables of docs/delays.md, and its figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
from matplotlib.axes import Axes
from tables import DOCUMENTS, WORKERS, Lines, Tables, header, heliarch, row

from heliarch import load_scenario
from launch_scripts.scenarios.preparation import RunOptions, prepare
from studies.compare.cases import with_settings
from studies.delays.results import TROUBLES, column_of
from studies.delays.study import Condition, Outcome, Trouble, run_under
from studies.workers import share_work

mpl.use("Agg")

MERITS = {
    "control-caused": "control-caused\nshortfall [% of desired]",
    "over-delivered": "over-delivered\n[% of desired]",
    "mileage": "mileage of support\n[kW/h]",
    "score": "PJM performance score",
}
"""The figures of merit that are drawn, and their names here."""

LOOKS = {"paper": ("#d55e00", "o"), "predictive": ("#0072b2", "s")}


def draw(outcomes: Sequence[Outcome]) -> None:
    """Draw the outcomes into the picture of the page."""
    figure, panels = plt.subplots(
        len(MERITS), len(TROUBLES), figsize=(9.5, 9.4), sharey="row", layout="constrained"
    )
    for across, (merit, what) in zip(panels, MERITS.items(), strict=True):
        for panel, (trouble, (_, measure, unit)) in zip(across, TROUBLES.items(), strict=True):
            for scheme in LOOKS:
                draw_curve(panel, merit, scheme, column_of(outcomes, trouble, scheme))
            panel.grid(color="#e4e4e4")
            panel.set_axisbelow(True)
            if merit == "score":
                panel.set_xlabel(f"{measure} [{unit}]")
            if merit == "mileage":
                panel.set_ylim(bottom=0.0)
                panel.yaxis.set_major_formatter("{x:,.0f}")
        across[0].set_ylabel(what)
        across[0].tick_params(axis="y", labelsize=8)
    panels[0][0].legend(loc="upper left", frameon=False)
    figure.savefig(DOCUMENTS / "delays.png", dpi=110)


def draw_curve(panel: Axes, merit: str, scheme: str, outcomes: list[Outcome]) -> None:
    """Draw a figure of merit of a scheme along a trouble, in even steps."""
    colour, marker = LOOKS[scheme]
    steps = range(len(outcomes))
    merits = [one.figures[merit] for one in outcomes]
    panel.plot(steps, merits, color=colour, marker=marker, ms=4, lw=1.4, label=scheme)
    panel.set_xticks(steps, [f"{one.value:g}" for one in outcomes], fontsize=8)


FIGURES: Final = {
    "control-caused": ("control-caused", 3),
    "over-delivered": ("over-delivered", 3),
    "mileage": ("mileage [kW/h]", 0),
    "regd": ("RegD [%]", 1),
    "score": ("score", 3),
}
TITLES: Final = tuple(title for title, _ in FIGURES.values())


@cache
def study() -> list[Outcome]:
    """Run the study, and draw it."""
    found = heliarch("delays", "--workers", str(WORKERS))["outcomes"]
    outcomes = msgspec.convert(found, list[Outcome])
    draw(outcomes)
    return outcomes


def under(trouble: Trouble, value: float, scheme: str) -> Outcome:
    """Return one outcome of the study."""
    return next(one for one in column_of(study(), trouble, scheme) if one.value == value)


def of_trouble(trouble: Trouble) -> Callable[[Path], Lines]:
    """Return what writes the table of a trouble."""

    def write(data: Path) -> Lines:
        _, measure, unit = TROUBLES[trouble]
        yield from header([f"{measure} [{unit}]", "scheme", *TITLES])
        for one in study():
            if one.trouble == trouble:
                yield row([f"{one.value:g}", one.scheme, *cells(one)])

    return write


def cells(one: Outcome) -> list[str]:
    """Return the figures of an outcome."""
    return [f"{one.figures[name]:,.{decimals}f}" for name, (_, decimals) in FIGURES.items()]


def measured(run: tuple[str, Condition]) -> Outcome:
    """Run the hour of the study with another setting, under a condition."""
    setting, condition = run
    scenario = with_settings(load_scenario("oahu-day"), ("commitment.share=0.6", setting))
    prepared = prepare(scenario, RunOptions("11:58", "62m"), "delays")
    return run_under(prepared.plan, prepared.profile, condition)


def longer_cycles(data: Path) -> Lines:
    """Write cycles that fit the delay beside those that do not."""
    yield from header(["delay of each hop [s]", "cycle [s]", "scheme", *TITLES])
    schemes = ("predictive", "paper")
    fits = [(0.2, 2), (0.5, 5)]
    runs = [
        (f"time.cycle_s={cycle_s}", Condition("delay", delay_s, scheme))
        for scheme in schemes
        for delay_s, cycle_s in fits
    ]
    found = iter(share_work(measured, runs, WORKERS))
    for scheme in schemes:
        for delay_s, cycle_s in fits:
            yield row([delay_s, 1, scheme, *cells(under("delay", delay_s, scheme))])
            yield row([delay_s, cycle_s, scheme, *cells(next(found))])


def without_correction(data: Path) -> Lines:
    """Write what the correction by the meter is worth under delay and loss."""
    conditions: list[tuple[Trouble, float, str]] = [
        ("delay", 0.0, "nothing"),
        ("delay", 0.2, "delay of 0.2 s per hop"),
        ("delay", 1.0, "delay of 1 s per hop"),
        ("delay", 10.0, "delay of 10 s per hop"),
        ("loss", 20.0, "20 % of all messages lost"),
    ]
    setting = "control.correction=false"
    runs = [(setting, Condition(trouble, value, "predictive")) for trouble, value, _ in conditions]
    found = share_work(measured, runs, WORKERS)
    yield from header(["trouble", "correction", *TITLES])
    for (trouble, value, label), without in zip(conditions, found, strict=True):
        yield row([label, "yes", *cells(under(trouble, value, "predictive"))])
        yield row([label, "no", *cells(without)])


TABLES: Final[Tables] = {
    **{trouble: of_trouble(trouble) for trouble in TROUBLES},
    "longer cycles": longer_cycles,
    "correction": without_correction,
}
