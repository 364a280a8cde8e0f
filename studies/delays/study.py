"""What delay, loss and a slow central controller cost.

The paper neglects communication delays. Here one run is repeated on the virtual clock, each time
with one thing worse: every message delayed on every hop, a share of all messages lost, or a
central controller that acts more rarely. Any difference is due to that alone, and repeatable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import msgspec
from msgspec.structs import replace

from agents.plan import RunPlan
from agents.settings import Scheme
from bus_schemas.faults import FaultRule
from launch_scripts.launcher.simulation import MemoryRun, on_the_clock
from recordings.read.series import RunSeries, SeriesCollector
from sim_plant.profile import Profile
from studies.arrays.control_arrays import is_corrected
from studies.metrics import run_metrics
from studies.metrics.figures_of_merit import figures_json

Trouble: TypeAlias = Literal["delay", "loss", "period"]
"""What is made worse: delay of each hop [s], share of lost messages [%], central period [s]."""

VALUES: Final[dict[Trouble, tuple[float, ...]]] = {
    "delay": (0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
    "loss": (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0),
    "period": (1.0, 2.0, 5.0, 10.0, 30.0, 60.0),
}

WARM_UP_S: Final = 120.0
"""The first seconds of each run, which do not count: with long delays messages are still coming."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One run of the study: what is worse than in the scenario, how much, and the scheme."""

    trouble: Trouble
    value: float
    scheme: Scheme


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of merit of one run, without its warm-up, and what happened to its messages.

    `absent_inputs` had not come at their deadline; `old_inputs` were used in their place.
    """

    trouble: Trouble
    value: float
    scheme: Scheme
    figures: dict[str, float | None]
    absent_inputs: int
    old_inputs: int


def conditions(plan: RunPlan) -> list[Condition]:
    """List the runs of the study: each value with each scheme.

    Left out are central periods that are no whole number of cycles, and those of which the time
    that counts does not hold two.
    """
    cycle_s = plan.cycle_ns / 1e9
    counted_s = plan.cycles * cycle_s - WARM_UP_S
    return [
        Condition(trouble, value, scheme)
        for trouble, values in VALUES.items()
        for value in values
        if trouble != "period" or ((value / cycle_s).is_integer() and 2.0 * value <= counted_s)
        for scheme in get_args(Scheme)
    ]


def plan_under(plan: RunPlan, condition: Condition) -> RunPlan:
    """Return a plan with the trouble of a condition, on the virtual clock."""
    scheme, value = condition.scheme, condition.value
    timed = replace(on_the_clock(plan), scheme=scheme, correction=is_corrected(plan, scheme))
    if condition.trouble == "period":
        cycles = round(value * 1e9) // plan.cycle_ns
        return replace(timed, period_cycles=(cycles, *(1 for _ in plan.period_cycles[1:])))
    if not value:
        return replace(timed, faults=())
    is_delay = condition.trouble == "delay"
    rule = FaultRule(delay_ms=1e3 * value) if is_delay else FaultRule(loss=value / 100.0)
    return replace(timed, faults=(rule,))


def run_in_memory(plan: RunPlan, profile: Profile) -> tuple[MemoryRun, RunSeries]:
    """Run a plan's agents in memory, message by message; return the run and its series."""
    collector = SeriesCollector(plan)
    run = MemoryRun(plan, profile, collector.see)
    for _ in run.cycles():
        pass
    return run, collector.series(plan.scheme)


def run_under(plan: RunPlan, profile: Profile, condition: Condition) -> Outcome:
    """Run a plan under a condition. The run must last longer than `WARM_UP_S`."""
    run, series = run_in_memory(plan_under(plan, condition), profile)
    warm_up = round(WARM_UP_S * 1e9) // plan.cycle_ns
    metrics = run_metrics(series.between(warm_up, series.cycles))
    return Outcome(
        trouble=condition.trouble,
        value=condition.value,
        scheme=condition.scheme,
        figures=figures_json(metrics),
        absent_inputs=sum(loop.missing_inputs for loop in run.loops.values()),
        old_inputs=sum(loop.old_inputs for loop in run.loops.values()),
    )
