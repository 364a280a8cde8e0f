"""How long a whole day takes: through the agents, and over arrays, beside the paper's own time.

Run by `make bench-study`. The day is `oahu-day`: 54,000 cycles of 1 s, 17 inverters, as the
paper's. Processor time is given beside wall time: on a busy machine the two differ.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from agents.settings import Scheme
from results.figures import run_figures
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario
from studies.arrays.schemes import SCHEMES, reference_groups, run_scheme
from studies.compare.by_agents import run_by_agents

PAPER_S = 14.144
"""Julien, Sajadi and Hodge, section III: one simulated day, with a quad-core processor of 2 GHz."""

ROUNDS = 3


def timed(action: Callable[[], object]) -> tuple[float, float]:
    """Median wall and processor time of some rounds [s]."""
    walls, processors = [], []
    for _ in range(ROUNDS):
        wall, processor = time.perf_counter(), time.process_time()
        action()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return statistics.median(walls), statistics.median(processors)


def line(name: str, times: tuple[float, float]) -> None:
    wall_s, processor_s = times
    sys.stdout.write(f"{name:44}{wall_s:9.2f} s{processor_s:9.2f} s\n")


def of_arrays(name: str, day: Preparation, groups: list[NDArray[np.bool_]]) -> None:
    run_scheme(name, day.plan, day.profile, day.plan.control.actuator, groups)


def main() -> None:
    began = time.perf_counter()
    day = prepare(load_scenario("oahu-day"), RunOptions(), "bench")
    prepared_s = time.perf_counter() - began
    one_group = [*reference_groups(len(day.plan.tree.leaves), [4])][:1]
    for name in SCHEMES:  # Compiled, or the compiled code loaded, before the clock runs.
        of_arrays(name, day, one_group)
    sys.stdout.write(f"{day.plan.timing.cycles:,} cycles, {len(day.plan.tree.leaves)} inverters; ")
    sys.stdout.write(f"sky, market and clusters worked out in {prepared_s:.1f} s\n")
    sys.stdout.write(f"{f'median of {ROUNDS}':44}{'wall':>11}{'processor':>11}\n")
    for scheme in get_args(Scheme):
        run = partial(run_by_agents, day.plan, day.profile, scheme, day.plan.control.actuator)
        line(f"agents, {scheme}", timed(run))
    sys.stdout.write(f"{'the paper, its own simulation':44}{PAPER_S:9.2f} s\n")
    for name in SCHEMES:
        times = timed(partial(of_arrays, name, day, one_group))
        line(f"arrays, {name}" + (" (one group)" if name == "grouping" else ""), times)
    (series,) = run_scheme("predictive", day.plan, day.profile, "fraction", one_group)
    line("figures of merit of one scheme", timed(partial(run_figures, series)))


if __name__ == "__main__":
    main()
