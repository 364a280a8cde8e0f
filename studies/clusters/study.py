"""The study of clusters: virtual neighbours compared with other ways to choose clusters.

One day is run many times, its inverters clustered in different ways.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np
import pandas as pd
from msgspec.structs import replace

from agents.control.clusters import ClusterSearch, search_clusters, within_cluster_correlation
from agents.control.correlation import hourly_correlation, hourly_covariance
from agents.plan import Neighbourhood, NodeNeighbourhoods, RunPlan
from agents.settings import Scheme
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree
from launch_scripts.scenarios.clustering import control_tree, in_order, neighbourhoods
from launch_scripts.scenarios.power_sources import power_source
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import ControlTable, ScenarioFile
from recordings.read.series import RunSeries
from sim_plant.profile import Profile
from sim_plant.sites import Sites
from studies.arrays.schemes import ReferenceGroups, run_scheme
from studies.metrics import commitment_metrics
from studies.metrics.help import HelpMetrics, help_metrics
from studies.report.cloud_passage import clusters, hours_from_first_midnight

_PAPER_PERIODS_S: Final = "1,10,60"
"""How often the central controller acts: always, and as slow as the paper's two upper tiers."""

_LONGEST_PERIOD: Final = 1e6


Arrange: TypeAlias = Callable[[ControlTable], Preparation]
"""Puts the inverters of one day into the clusters that a control table asks for."""


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Shortfall of a run, in % of the desired energy.

    `begun_lacking_percent` is the part of the control-caused shortfall in periods at whose
    beginning the whole plant lacked power. The paper's central controller then asks each cluster
    for what it has at that moment, and this holds until its next turn, even if the clouds are soon
    gone. The predictive scheme tops the clusters up.
    """

    central_period_s: float
    period_cycles: int
    unavoidable_percent: float
    control_caused_percent: float
    begun_lacking_percent: float


@dataclass(frozen=True, slots=True)
class ClustersWorth:
    """The result of a run with its inverters clustered in one way.

    The correlation is the mean hourly one of power over all pairs that share a cluster of the
    lowest tier: in the past that clusters are chosen from, and in the run itself. `help` is where
    inverters in need found help, at the first of the central controller's periods; `shortfalls` has
    an entry for each of those periods.
    """

    members: tuple[tuple[str, ...], ...]
    past_correlation: float
    run_correlation: float
    help: HelpMetrics
    shortfalls: tuple[Shortfall, ...]


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
        search=search_clusters(past.to_numpy(), [len(cluster) for cluster in virtual.members]),
    )


def _worth(
    arrange: Arrange,
    past: pd.DataFrame,
    scheme: Scheme,
    periods: tuple[int, ...],
    control: ControlTable,
) -> ClustersWorth:
    return worth_of(arrange(control), past, scheme, periods)


def central_periods(text: str | None, plan: RunPlan) -> tuple[int, ...]:
    """Read periods of the central controller in seconds; return them in cycles.

    By default those of the paper that are whole numbers of cycles.
    """
    cycle_s = plan.cycle_ns / 1e9
    expected = f"--periods: expected multiples of the cycle, {cycle_s:g} s, such as 10,60"
    try:
        cycles = [float(word) / cycle_s for word in (text or _PAPER_PERIODS_S).split(",")]
    except ValueError:
        raise InputError(f"{expected}, got {text}") from None
    whole = [
        round(count)
        for count in cycles
        if 0.5 < count < _LONGEST_PERIOD and abs(count - round(count)) <= 1e-6
    ]
    if text is not None and len(whole) < len(cycles):
        raise InputError(f"{expected}, got {text}")
    return tuple(whole) or (1,)


def by_scenario(scenario: ScenarioFile, options: RunOptions, control: ControlTable) -> Preparation:
    """Arrange a scenario's run as any other command does: clusters from the scenario's past."""
    changed = replace(scenario.scenario, control=control)
    return prepare(replace(scenario, scenario=changed), options, "clusters")


def by_first_part(preparation: Preparation, learn_s: float) -> Arrange:
    """Arrange the rest of a run after its first part, with clusters chosen from that part alone.

    So a measurement of one day can be used without hindsight. The scenario's own past is ignored,
    and the first part is one past, not one for each of its hours.
    """
    plan = preparation.plan
    cycle_s = plan.cycle_ns / 1e9
    learned = round(learn_s / cycle_s)
    if abs(learned * cycle_s - learn_s) > 1e-6 or not 2 <= learned < plan.cycles:
        raise InputError(
            f"--learn: expected a multiple of the cycle, {cycle_s:g} s, from {2 * cycle_s:g} to "
            f"{(plan.cycles - 1) * cycle_s:g} s, got {learn_s:g} s"
        )
    first = pd.DatetimeIndex([pd.Timestamp(plan.start_time_ns, tz="UTC")])
    sites = power_source(preparation.scenario, None, first).sites
    return partial(_by_first_part, preparation, sites, learned)


def _by_first_part(
    preparation: Preparation, sites: Sites, learned: int, control: ControlTable
) -> Preparation:
    plan, profile = preparation.plan, preparation.profile
    listed = [_leaf_names(plan.tree).index(name) for name in sites.names]
    past = hourly_covariance(profile.mpp_kw[:learned, listed], np.zeros(learned, dtype=np.int64))
    begins_ns = plan.sim_time_ns(learned)
    tree = control_tree(control, sites, past, list(past))
    order = [sites.names.index(name) for name in _leaf_names(tree)]
    rest = replace(
        plan,
        inverters=tree.inverters,
        neighbourhoods=neighbourhoods(tree, in_order(past, order), {0: begins_ns}),
        start_time_ns=begins_ns,
        cycles=plan.cycles - learned,
    )
    columns = [listed[place] for place in order]
    of_rest = Profile(
        np.ascontiguousarray(profile.mpp_kw[learned:, columns]),
        profile.commitment_kw[learned:],
        profile.regulation_kw[learned:],
        profile.regulation_capacity_kw,
        np.ascontiguousarray(profile.meter_error[learned:, columns]),
    )
    return dataclasses.replace(preparation, plan=rest, profile=of_rest)


def past_of(arrange: Arrange, control: ControlTable, inverters: int) -> pd.DataFrame:
    """Return the mean hourly correlation of every two inverters (paper, eq. 5), by their names.

    Only the hours of the run count. Clusters are chosen from all hours of the scenario, which are
    more if only a part of it is run.
    """
    # In one cluster of all inverters, everybody is a neighbour of everybody.
    one_cluster = replace(
        control,
        clusters="listed",
        cluster_sizes=((inverters,),),
        cluster_count=None,
        period_cycles=None,
    )
    plan = arrange(one_cluster).plan
    (cluster,) = plan.tree.children("")
    hourly = [hood.correlation for hood in plan.neighbourhoods_of(cluster)]
    names = _leaf_names(plan.tree)
    return pd.DataFrame(np.mean(hourly, axis=0), names, names)


def worth_of(
    preparation: Preparation, past: pd.DataFrame, scheme: Scheme, periods: Sequence[int]
) -> ClustersWorth:
    """Run a plant, once for each period of the central controller [cycles]."""
    plan, profile = preparation.plan, preparation.profile
    runs = []
    for period in periods:
        paced = replace(plan, period_cycles=(period, *plan.period_cycles[1:]))
        runs += run_scheme(scheme, paced, profile, plan.actuator, ReferenceGroups())
    shared = list(clusters(runs[0]).values())
    names = _leaf_names(plan.tree)
    members = tuple(tuple(names[leaf] for leaf in cluster) for cluster in shared)
    places = {name: place for place, name in enumerate(past.index)}
    in_past = [[places[name] for name in cluster] for cluster in members]
    in_run = hourly_correlation(runs[0].mpp_kw, hours_from_first_midnight(runs[0]))
    return ClustersWorth(
        members=members,
        past_correlation=within_cluster_correlation(past.to_numpy(), in_past),
        run_correlation=within_cluster_correlation(np.mean([*in_run.values()], axis=0), shared),
        help=help_metrics(runs[0].residual_kw, runs[0].inverters),
        shortfalls=tuple(
            _shortfall(run, period, period * plan.cycle_ns / 1e9)
            for run, period in zip(runs, periods, strict=True)
        ),
    )


def in_other_orders(preparation: Preparation) -> dict[str, Preparation]:
    """Return the same clusters with other orders in which an inverter in need asks for help."""
    plan = preparation.plan

    def turned(hood: Neighbourhood) -> Neighbourhood:
        # With the opposite correlation those most alike are asked first.
        correlation = tuple(tuple(-value for value in row) for row in hood.correlation)
        return Neighbourhood(hood.from_time_ns, correlation)

    reversed_order = tuple(
        NodeNeighbourhoods(entry.node, tuple(map(turned, entry.hours)))
        for entry in plan.neighbourhoods
    )
    orders = {
        "least alike first": plan,
        "as listed": replace(plan, neighbourhoods=()),
        "most alike first": replace(plan, neighbourhoods=reversed_order),
    }
    return {name: dataclasses.replace(preparation, plan=own) for name, own in orders.items()}


def _shortfall(run: RunSeries, period: int, period_s: float) -> Shortfall:
    turn = np.arange(run.cycles) // period * period
    lacking = run.residual_kw.sum(axis=1)[turn] < 0.0
    desired_kw, possible_kw, delivered_kw = run.desired_kw, run.possible_kw, run.delivered_kw
    energy = commitment_metrics(desired_kw, possible_kw, delivered_kw, run.cycle_s)
    begun_lacking = commitment_metrics(
        desired_kw[lacking], possible_kw[lacking], delivered_kw[lacking], run.cycle_s
    )
    if not energy.desired_kwh > 0.0:
        raise InputError("commitment: expected more than 0 kW at some time, got none")
    in_percent = 100.0 / energy.desired_kwh
    return Shortfall(
        period_s,
        period,
        in_percent * energy.unavoidable_kwh,
        in_percent * energy.control_caused_kwh,
        in_percent * begun_lacking.control_caused_kwh,
    )


def _leaf_names(tree: ControlTree) -> tuple[str, ...]:
    return tuple(leaf.rpartition("/")[2] for leaf in tree.leaves)
