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

Arrange: TypeAlias = Callable[[ControlTable], Preparation]
"""Puts the inverters of one day into the clusters that a control table asks for."""


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Shortfall of a run, in % of the desired energy.

    `begun_lacking_percent` is the part of the control-caused shortfall in periods at whose
    beginning the whole plant lacked power.
    """

    central_period_s: float
    unavoidable_percent: float
    control_caused_percent: float
    begun_lacking_percent: float


@dataclass(frozen=True, slots=True)
class ClustersWorth:
    """The result of a run with its inverters clustered in one way.

    The correlation is the mean hourly one of power over all pairs that share a cluster, in the past
    that clusters are chosen from and in the run. `help` is for the first of the central
    controller's periods; `shortfalls` has an entry for each.
    """

    members: tuple[tuple[str, ...], ...]
    past_correlation: float
    run_correlation: float
    help: HelpMetrics
    shortfalls: tuple[Shortfall, ...]


@dataclass(frozen=True, slots=True)
class ClusterStudy:
    """One run under different clusters, and under other orders of help in the virtual ones.

    `ways` has one result for each way to choose clusters, for `random` one for each seed.
    """

    title: str
    ways: dict[str, list[ClustersWorth]]
    orders: dict[str, ClustersWorth]
    search: ClusterSearch


def study_clusters(
    preparation: Preparation,
    arrange: Arrange,
    periods: tuple[int, ...],
    seeds: int,
    run_each: Callable[
        [Callable[[ControlTable], ClustersWorth], Sequence[ControlTable]], list[ClustersWorth]
    ],
) -> ClusterStudy:
    """Run all ways to choose clusters, `random` as often as there are `seeds`.

    `periods` are those of the central controller in cycles, `run_each` applies a function to each
    of some items.
    """
    control = preparation.scenario.scenario.control
    past = past_of(arrange, control, len(preparation.plan.inverters))
    run = arrange(replace(control, clusters="correlation"))
    orders = {name: worth_of(other, past, periods) for name, other in in_other_orders(run).items()}
    virtual = orders["least alike first"]
    tables = [
        replace(control, clusters="geographic"),
        replace(control, clusters="most-alike"),
        *(replace(control, clusters="random", clusters_seed=seed + 1) for seed in range(seeds)),
    ]
    geographic, alike, *random = run_each(partial(_worth, arrange, past, periods), tables)
    return ClusterStudy(
        title=f"{run.title()}, scheme {run.plan.scheme}, actuator {run.plan.actuator}",
        ways={
            "virtual": [virtual],
            "geographic": [geographic],
            "random": random,
            "most alike": [alike],
        },
        orders=orders,
        search=search_clusters(past.to_numpy(), [len(cluster) for cluster in virtual.members]),
    )


def _worth(
    arrange: Arrange, past: pd.DataFrame, periods: tuple[int, ...], control: ControlTable
) -> ClustersWorth:
    return worth_of(arrange(control), past, periods)


def central_periods(text: str | None, plan: RunPlan) -> tuple[int, ...]:
    """Read periods of the central controller in seconds; return them in cycles.

    By default those of the paper that are whole numbers of cycles.
    """
    try:
        periods_ns = [round(float(word) * 1e9) for word in (text or _PAPER_PERIODS_S).split(",")]
    except (OverflowError, ValueError):
        periods_ns = [0]
    fitting = [period for period in periods_ns if period > 0 and period % plan.cycle_ns == 0]
    if text is not None and fitting != periods_ns:
        cycle_s = plan.cycle_ns / 1e9
        raise InputError(
            f"--periods: expected multiples of the cycle, {cycle_s:g} s, such as 10,60, got {text}"
        )
    return tuple(period // plan.cycle_ns for period in fitting) or (1,)


def by_scenario(scenario: ScenarioFile, options: RunOptions, control: ControlTable) -> Preparation:
    """Arrange a scenario's run as any other command does."""
    changed = replace(scenario.scenario, control=control)
    return prepare(replace(scenario, scenario=changed), options, "clusters")


def by_first_part(preparation: Preparation, learn_s: float) -> Arrange:
    """Arrange the rest of a run after its first part, with clusters chosen from that part alone.

    The first part is one past, not one for each of its hours.
    """
    plan = preparation.plan
    learned, beyond_ns = divmod(round(learn_s * 1e9), plan.cycle_ns)
    if beyond_ns or not 2 <= learned < plan.cycles:
        raise InputError(
            "--learn: expected a multiple of the cycle, two or more, and shorter than the run, "
            f"got {learn_s:g} s"
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


def worth_of(preparation: Preparation, past: pd.DataFrame, periods: Sequence[int]) -> ClustersWorth:
    """Run a plant, once for each period of the central controller [cycles]."""
    plan, profile = preparation.plan, preparation.profile
    runs = []
    for period in periods:
        paced = replace(plan, period_cycles=(period, *plan.period_cycles[1:]))
        runs += run_scheme(plan.scheme, paced, profile, plan.actuator, ReferenceGroups())
    shared = list(clusters(runs[0]).values())
    names = _leaf_names(plan.tree)
    members = tuple(tuple(names[leaf] for leaf in cluster) for cluster in shared)
    known = list(past.index)
    in_past = [[known.index(name) for name in cluster] for cluster in members]
    in_run = hourly_correlation(runs[0].mpp_kw, hours_from_first_midnight(runs[0]))
    return ClustersWorth(
        members=members,
        past_correlation=within_cluster_correlation(past.to_numpy(), in_past),
        run_correlation=within_cluster_correlation(np.mean([*in_run.values()], axis=0), shared),
        help=help_metrics(runs[0].residual_kw, runs[0].inverters),
        shortfalls=tuple(map(_shortfall, runs, periods)),
    )


def in_other_orders(preparation: Preparation) -> dict[str, Preparation]:
    """Return the same clusters with other orders in which an inverter in need asks for help."""
    plan = preparation.plan
    # With the opposite correlation those most alike are asked first.
    turned = tuple(
        NodeNeighbourhoods(
            entry.node,
            tuple(
                Neighbourhood(hood.from_time_ns, (-np.array(hood.correlation)).tolist())
                for hood in entry.hours
            ),
        )
        for entry in plan.neighbourhoods
    )
    orders = {
        "least alike first": plan,
        "as listed": replace(plan, neighbourhoods=()),
        "most alike first": replace(plan, neighbourhoods=turned),
    }
    return {name: dataclasses.replace(preparation, plan=own) for name, own in orders.items()}


def _shortfall(run: RunSeries, period: int) -> Shortfall:
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
        period * run.cycle_s,
        in_percent * energy.unavoidable_kwh,
        in_percent * energy.control_caused_kwh,
        in_percent * begun_lacking.control_caused_kwh,
    )


def _leaf_names(tree: ControlTree) -> tuple[str, ...]:
    return tuple(leaf.rpartition("/")[2] for leaf in tree.leaves)
