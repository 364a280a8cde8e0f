"""How fast are plants in this checkout and in others? What `make bench-before` runs.

Each round launches a plant in lockstep once with the code of each checkout, and the environment of
this one:

    git worktree add --detach /tmp/before COMMIT
    python benchmarks/before_after.py /tmp/before

Processor time is seen from outside, as in `cycle_rate.py`. With two other checkouts it takes some
15 minutes on two quiet cores.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Final

from harness import OURS, launch, measure

PLANTS: Final = {"oahu": 800, "thousand": 100, "ten-thousand": 15}
"""Scenarios, and their cycles in a run."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("others", nargs="+", type=Path, metavar="DIR", help="another checkout")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=[*PLANTS])
    words = parser.parse_args()
    for plant in words.plants:
        ways = {
            str(checkout): partial(launch, checkout, plant, PLANTS[plant])
            for checkout in (OURS, *words.others)
        }
        shown = "cycles_per_s", "processor_ms", "startup_s"
        measure(f"{plant}: {PLANTS[plant]} cycles", words.rounds, ways, shown)


if __name__ == "__main__":
    main()
