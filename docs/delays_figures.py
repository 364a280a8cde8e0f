"""Draws the study of delay, loss and slow central control as docs/delays.png.

heliarch timing --study --json study.json
python docs/delays_figures.py study.json docs/delays.png
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import msgspec

mpl.use("Agg")

TROUBLES = {
    "delay": "delay of each hop [s]",
    "loss": "lost messages [%]",
    "period": "central period [s]",
}
MERITS = {
    "control_caused_percent": "control-caused\nshortfall [% of desired]",
    "mileage_kw_per_h": "mileage of support\n[kW/h]",
    "score": "PJM performance score",
}
LOOKS = {"paper": ("#d55e00", "o"), "predictive": ("#0072b2", "s")}


def draw(study: dict[str, Any], picture: Path) -> None:
    """Draw the outcomes with late messages used into a PNG file."""
    figure, panels = plt.subplots(
        len(MERITS), len(TROUBLES), figsize=(9.5, 7.4), sharey="row", layout="constrained"
    )
    for row, (merit, what) in zip(panels, MERITS.items(), strict=True):
        for panel, (trouble, unit) in zip(row, TROUBLES.items(), strict=True):
            for scheme, (colour, marker) in LOOKS.items():
                found = [
                    one
                    for one in study["outcomes"]
                    if (one["trouble"], one["scheme"], one["late"]) == (trouble, scheme, "use")
                ]
                steps = range(len(found))
                merits = [one[merit] for one in found]
                panel.plot(steps, merits, color=colour, marker=marker, ms=4, lw=1.4, label=scheme)
                panel.set_xticks(steps, [f"{one['value']:g}" for one in found], fontsize=8)
            panel.grid(color="#e4e4e4")
            panel.set_axisbelow(True)
            if merit == "score":
                panel.set_xlabel(unit)
            if merit == "mileage_kw_per_h":
                panel.set_ylim(bottom=0.0)
                panel.yaxis.set_major_formatter("{x:,.0f}")
        row[0].set_ylabel(what)
        row[0].tick_params(axis="y", labelsize=8)
    panels[0][0].legend(loc="upper left", frameon=False)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    draw(msgspec.json.decode(Path(sys.argv[1]).read_bytes()), Path(sys.argv[2]))
