"""Draws a run: possible, desired and delivered power, and who called for help.

python docs/run_figure.py runs/oahu-... docs/run.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from bus_schemas.messages import Production
from bus_schemas.signals import HELP, PRODUCTION
from bus_schemas.tree import ROOT
from recordings.read.reader import RunReader

mpl.use("Agg")


def draw(run: Path, picture: Path) -> None:
    """Draw a recording into a PNG file."""
    with RunReader(run) as reader:
        produced = [m for _, m in reader.messages(PRODUCTION) if isinstance(m, Production)]
        calls = [(port.node, message.cycle) for port, message in reader.messages(HELP)]
        tree, cycle_s = reader.plan.tree, reader.plan.cycle_ns / 1e9
    minutes = np.arange(len(produced)) * cycle_s / 60.0
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(9.5, 5.6), sharex=True, height_ratios=[3, 2], layout="constrained"
    )
    possible_mw = [message.possible_kw / 1e3 for message in produced]
    top.fill_between(minutes, possible_mw, color="#f5d78e", label="possible", linewidth=0)
    top.plot(minutes, [m.delivered_kw / 1e3 for m in produced], color="#1b7837", label="delivered")
    top.plot(
        minutes, [m.desired_kw / 1e3 for m in produced], "--", color="black", label="desired", lw=1
    )
    top.set_ylabel("plant power [MW]")
    top.set_ylim(bottom=0)
    top.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    rows = [*tree.leaves[::-1], *(node for node in tree.parents[::-1] if node != ROOT), ROOT]
    needy = np.zeros((len(rows), len(produced)))
    for node, cycle in calls:
        needy[rows.index(node), cycle] = 1.0
    bottom.imshow(
        needy,
        aspect="auto",
        cmap="Reds",
        interpolation="none",
        vmin=0,
        vmax=1,
        origin="lower",
        extent=(0, minutes[-1], -0.5, len(rows) - 0.5),
    )
    bottom.set_yticks(range(len(rows)), [row or "plant" for row in rows], fontsize=6)
    bottom.set_ylabel("calls for help")
    bottom.set_xlabel("time [min]")
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
