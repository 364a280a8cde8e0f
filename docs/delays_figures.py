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

from studies.delays.page import StudyCurve, study_curves
from studies.delays.study import Outcome

mpl.use("Agg")

MERITS = {
    "control-caused": "control-caused\nshortfall [% of desired]",
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
    curves = study_curves(study.outcomes)
    troubles = list(dict.fromkeys(curve.trouble for curve in curves))
    figure, panels = plt.subplots(
        len(MERITS), len(troubles), figsize=(9.5, 7.4), sharey="row", layout="constrained"
    )
    for row, (merit, what) in zip(panels, MERITS.items(), strict=True):
        for panel, trouble in zip(row, troubles, strict=True):
            for curve in curves:
                if (curve.figure, curve.trouble) == (merit, trouble):
                    draw_curve(panel, curve)
            panel.grid(color="#e4e4e4")
            panel.set_axisbelow(True)
            if merit == "score":
                panel.set_xlabel(trouble)
            if merit == "mileage":
                panel.set_ylim(bottom=0.0)
                panel.yaxis.set_major_formatter("{x:,.0f}")
        row[0].set_ylabel(what)
        row[0].tick_params(axis="y", labelsize=8)
    panels[0][0].legend(loc="upper left", frameon=False)
    figure.savefig(picture, dpi=110)


def draw_curve(panel: Axes, curve: StudyCurve) -> None:
    """Draw a scheme along a trouble, in even steps."""
    colour, marker = LOOKS[curve.scheme]
    steps = range(len(curve.values))
    panel.plot(steps, curve.merits, color=colour, marker=marker, ms=4, lw=1.4, label=curve.scheme)
    panel.set_xticks(steps, [f"{value:g}" for value in curve.values], fontsize=8)


if __name__ == "__main__":
    draw(msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=Study), Path(sys.argv[2]))
