"""Draws the study of delay, loss and slow central control as docs/delays.png.

heliarch delays --json study.json
python docs/delays_figures.py study.json docs/delays.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec
from matplotlib.axes import Axes

from studies.delays.study import Outcome
from studies.delays.tables import TROUBLES, column_of

mpl.use("Agg")

MERITS = {
    "control-caused": "control-caused\nshortfall [% of desired]",
    "over-delivered": "over-delivered\n[% of desired]",
    "mileage": "mileage of support\n[kW/h]",
    "score": "PJM performance score",
}
"""The figures of merit that are drawn, and their names here."""

LOOKS = {"paper": ("#d55e00", "o"), "predictive": ("#0072b2", "s")}


class Study(msgspec.Struct):
    """The part of the document that is drawn."""

    outcomes: list[Outcome]


def draw(study: Study, picture: Path) -> None:
    """Draw the outcomes into a PNG file."""
    figure, panels = plt.subplots(
        len(MERITS), len(TROUBLES), figsize=(9.5, 9.4), sharey="row", layout="constrained"
    )
    for row, (merit, what) in zip(panels, MERITS.items(), strict=True):
        for panel, (trouble, (_, measure, unit)) in zip(row, TROUBLES.items(), strict=True):
            for scheme in LOOKS:
                draw_curve(panel, merit, scheme, column_of(study.outcomes, trouble, scheme))
            panel.grid(color="#e4e4e4")
            panel.set_axisbelow(True)
            if merit == "score":
                panel.set_xlabel(f"{measure} [{unit}]")
            if merit == "mileage":
                panel.set_ylim(bottom=0.0)
                panel.yaxis.set_major_formatter("{x:,.0f}")
        row[0].set_ylabel(what)
        row[0].tick_params(axis="y", labelsize=8)
    panels[0][0].legend(loc="upper left", frameon=False)
    figure.savefig(picture, dpi=110)


def draw_curve(panel: Axes, merit: str, scheme: str, outcomes: list[Outcome]) -> None:
    """Draw a figure of merit of a scheme along a trouble, in even steps."""
    colour, marker = LOOKS[scheme]
    steps = range(len(outcomes))
    merits = [one.figures[merit] for one in outcomes]
    panel.plot(steps, merits, color=colour, marker=marker, ms=4, lw=1.4, label=scheme)
    panel.set_xticks(steps, [f"{one.value:g}" for one in outcomes], fontsize=8)


if __name__ == "__main__":
    draw(msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=Study), Path(sys.argv[2]))
