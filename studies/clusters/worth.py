"""What clusters are worth: one day run many times, its inverters clustered in different ways."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.control.clusters import within_cluster_correlation
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


class Arrangement(NamedTuple):
    """A run with its inverters in clusters, ready for any scheme."""

    plan: RunPlan
    profile: Profile


Arrange: TypeAlias = Callable[[ControlTable], Arrangement]
"""Puts the inverters of one day into the clusters that a control table asks for."""


@dataclass(frozen=True, slots=True, eq=False)
class Past:
    """The past that clusters are chosen from.

    `correlation` is the mean hourly correlation of the n inverters (paper, eq. 5), shape (n, n).
    """

    inverters: tuple[str, ...]
    correlation: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Shortfall of a run, in % of the desired energy.

    `begun_lacking_percent` is the part of the control-caused shortfall in periods at whose
    beginning the whole plant lacked power. The paper's central controller then asks each cluster
    for what it has at that moment, and this holds until its next turn, even if the clouds are soon
    gone. The predictive scheme tops the clusters up.
    """

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

    clusters: tuple[tuple[str, ...], ...]
    past_correlation: float
    run_correlation: float
    help: HelpMetrics
    shortfalls: tuple[Shortfall, ...]


def by_scenario(scenario: ScenarioFile, options: RunOptions, control: ControlTable) -> Arrangement:
    """Arrange a scenario's run as any other command does: clusters from the scenario's past."""
    changed = replace(scenario.scenario, control=control)
    prepared = prepare(replace(scenario, scenario=changed), options, "clusters")
    return Arrangement(prepared.plan, prepared.profile)


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
    return partial(_by_first_part, plan, preparation.profile, sites, learned)


def _by_first_part(
    plan: RunPlan, profile: Profile, sites: Sites, learned: int, control: ControlTable
) -> Arrangement:
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
    return Arrangement(
        rest,
        Profile(
            np.ascontiguousarray(profile.mpp_kw[learned:, columns]),
            profile.commitment_kw[learned:],
            profile.regulation_kw[learned:],
            profile.regulation_capacity_kw,
            np.ascontiguousarray(profile.meter_error[learned:, columns]),
        ),
    )


def past_of(arrange: Arrange, control: ControlTable, inverters: int) -> Past:
    """Return the past of a run of so many inverters, for the hours of the run alone.

    Clusters are chosen from the hours of the whole scenario: the same, unless a part of it is run.
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
    return Past(_leaf_names(plan.tree), np.asarray(np.mean(hourly, axis=0)))


def worth_of(
    arrangement: Arrangement, past: Past, scheme: Scheme, periods: Sequence[int]
) -> ClustersWorth:
    """Run an arrangement, once for each period of the central controller [cycles]."""
    plan, profile = arrangement
    runs = []
    for period in periods:
        paced = replace(plan, period_cycles=(period, *plan.period_cycles[1:]))
        runs += run_scheme(scheme, paced, profile, plan.actuator, ReferenceGroups())
    shared = list(clusters(runs[0]).values())
    names = _leaf_names(plan.tree)
    in_past = [[past.inverters.index(names[leaf]) for leaf in cluster] for cluster in shared]
    in_run = hourly_correlation(runs[0].mpp_kw, hours_from_first_midnight(runs[0]))
    return ClustersWorth(
        clusters=tuple(tuple(names[leaf] for leaf in cluster) for cluster in shared),
        past_correlation=within_cluster_correlation(past.correlation, in_past),
        run_correlation=within_cluster_correlation(np.mean([*in_run.values()], axis=0), shared),
        help=help_metrics(runs[0].residual_kw, runs[0].inverters),
        shortfalls=tuple(map(_shortfall, runs, periods)),
    )


def in_other_orders(arrangement: Arrangement) -> dict[str, Arrangement]:
    """Return the same clusters with other orders in which an inverter in need asks for help."""
    plan, profile = arrangement

    def turned(hood: Neighbourhood) -> Neighbourhood:
        # With the opposite correlation those most alike are asked first.
        correlation = tuple(tuple(-value for value in row) for row in hood.correlation)
        return Neighbourhood(hood.from_time_ns, correlation)

    reversed_order = tuple(
        NodeNeighbourhoods(entry.node, tuple(map(turned, entry.hours)))
        for entry in plan.neighbourhoods
    )
    return {
        "least alike first": arrangement,
        "as listed": Arrangement(replace(plan, neighbourhoods=()), profile),
        "most alike first": Arrangement(replace(plan, neighbourhoods=reversed_order), profile),
    }


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
        period,
        in_percent * energy.unavoidable_kwh,
        in_percent * energy.control_caused_kwh,
        in_percent * begun_lacking.control_caused_kwh,
    )


def _leaf_names(tree: ControlTree) -> tuple[str, ...]:
    return tuple(leaf.rpartition("/")[2] for leaf in tree.leaves)
