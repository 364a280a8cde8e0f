"""The study of clusters: virtual neighbours compared with other ways to choose clusters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from msgspec.structs import replace

from agents.control.clusters import ClusterSearch, search_clusters
from agents.plan import RunPlan
from agents.settings import Scheme
from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import Preparation
from launch_scripts.scenarios.scenario import ControlTable
from studies.clusters.worth import (
    Arrange,
    ClustersWorth,
    Past,
    in_other_orders,
    past_of,
    worth_of,
)

_PAPER_PERIODS_S: Final = "1,10,60"
"""How often the central controller acts: always, and as slow as the paper's two upper tiers."""

_LONGEST_PERIOD: Final = 1e6


@dataclass(frozen=True, slots=True)
class ClusterStudy:
    """The results of one run under different clusters.

    `ways` has the results for each way to choose clusters, for `random` one for each seed; `orders`
    those for each order of help in the virtual clusters; `search` how these were found.
    """

    title: str
    ways: dict[str, list[ClustersWorth]]
    orders: dict[str, ClustersWorth]
    search: ClusterSearch

    @property
    def periods_s(self) -> list[float]:
        """How often the central controller acts, in one run after the other."""
        (virtual,) = self.ways["virtual"]
        return [shortfall.central_period_s for shortfall in virtual.shortfalls]


def study_clusters(
    preparation: Preparation,
    arrange: Arrange,
    periods: tuple[int, ...],
    seeds: int,
    run_each: Callable[
        [Callable[[ControlTable], ClustersWorth], Sequence[ControlTable]], list[ClustersWorth]
    ],
) -> ClusterStudy:
    """Run all ways to choose clusters.

    periods: Every how many cycles the central controller acts, one after the other.
    seeds: How many random choices.
    run_each: Applies a function to each of some items.
    """
    control, scheme = preparation.scenario.scenario.control, preparation.plan.scheme
    past = past_of(arrange, control, len(preparation.plan.inverters))
    run = arrange(replace(control, clusters="correlation"))
    orders = {
        name: worth_of(other, past, scheme, periods) for name, other in in_other_orders(run).items()
    }
    virtual = orders["least alike first"]
    tables = [
        replace(control, clusters="geographic"),
        replace(control, clusters="most-alike"),
        *(replace(control, clusters="random", clusters_seed=seed + 1) for seed in range(seeds)),
    ]
    geographic, alike, *random = run_each(partial(_worth, arrange, past, scheme, periods), tables)
    ways = {
        "virtual": [virtual],
        "geographic": [geographic],
        "random": random,
        "most alike": [alike],
    }
    return ClusterStudy(
        title=f"{run.title()}, scheme {scheme}, actuator {run.plan.actuator}",
        ways=ways,
        orders=orders,
        search=search_clusters(past.correlation, [len(cluster) for cluster in virtual.members]),
    )


def _worth(
    arrange: Arrange, past: Past, scheme: Scheme, periods: tuple[int, ...], control: ControlTable
) -> ClustersWorth:
    return worth_of(arrange(control), past, scheme, periods)


def central_periods(text: str | None, plan: RunPlan) -> tuple[int, ...]:
    """Read periods of the central controller in seconds; return them in cycles.

    By default those of the paper that are whole numbers of cycles.
    """
    cycle_s = plan.cycle_ns / 1e9
    periods = []
    for word in (_PAPER_PERIODS_S if text is None else text).split(","):
        if cycles := _in_cycles(word, cycle_s):
            periods.append(cycles)
        elif text is not None:
            raise InputError(
                f"--periods: expected multiples of the cycle, {cycle_s:g} s, such as 10,60, "
                f"got {word}"
            )
    return tuple(periods) or (1,)


def _in_cycles(period: str, cycle_s: float) -> int:
    """Return a period in cycles; 0 if it is no whole number of them."""
    try:
        cycles = float(period) / cycle_s
    except ValueError:
        return 0
    if not 0.5 < cycles < _LONGEST_PERIOD or abs(cycles - round(cycles)) > 1e-6:
        return 0
    return round(cycles)
