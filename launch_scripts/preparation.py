"""Works out, before anything starts, all that a run needs: from a scenario to plan and profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, time
from typing import Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.control.clusters import choose_clusters, geographic_clusters
from agents.control.correlation import HourlyMatrices, group_correlation, hourly_covariance
from agents.family import Neighbourhood
from agents.periods import Periods
from agents.plan import NodeNeighbourhoods, RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree, as_ratings, depth
from launch_scripts.scenario import (
    CloudIrradiance,
    MeasuredIrradiance,
    ScenarioFile,
    local_start,
    parse_duration_s,
)
from sim_plant.clouds import clear_sky_ghi, synthetic_ghi
from sim_plant.commitment import commitment_kw
from sim_plant.irradiance import read_measured_ghi, window
from sim_plant.profile import Profile
from sim_plant.pv import ac_power_kw
from sim_plant.sites import Sites, equal_ratings_kw, read_sites

_TIER_LETTERS: Final = "czar"
"""Clusters are c1, c2, ...; zones of clusters z1, ...; then areas and regions."""

_ANOTHER_DAY: Final = 1_000_003
"""Added to a seed: the same climate on another day."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line may change about a scenario. None leaves it as it is."""

    start: str | None = None
    duration: str | None = None
    pace: float | Literal["max"] | None = None
    seed: int | None = None


@dataclass(frozen=True, slots=True)
class Preparation:
    """A run that is ready to start."""

    plan: RunPlan
    profile: Profile
    scenario: ScenarioFile
    hindsight: bool

    def local_start(self) -> str:
        """Return the local time of cycle 0, to be read."""
        moment = pd.Timestamp(self.plan.start_time_ns, tz="UTC")
        return f"{moment.tz_convert(self.scenario.scenario.time.timezone):%Y-%m-%d %H:%M:%S %Z}"


def prepare(scenario_file: ScenarioFile, options: RunOptions, run_id: str) -> Preparation:
    """Work out a run.

    Raises
    ------
    InputError
        Scenario, options and data do not go together.
    """
    scenario = scenario_file.scenario
    cycle_s = scenario.time.cycle_s
    times = _times(scenario_file, options)
    sites, mpp_kw = _possible_power(scenario_file, times, options)
    history_kw = _history_power(scenario_file, times, options, sites, mpp_kw)
    hours = _local_hours(times, scenario.time.timezone)
    covariance = hourly_covariance(history_kw, hours)
    tree = _control_tree(scenario_file, sites, covariance)
    # The plant's order is the tree's: clusters may have mixed the inverters up.
    order = [sites.names.index(leaf.rpartition("/")[2]) for leaf in tree.leaves]
    commitment = commitment_kw(
        scenario.commitment, mpp_kw.sum(axis=1), _clear_sky_power_kw(scenario_file, times, sites)
    )
    pace = options.pace or scenario.pace
    plan = RunPlan(
        run_id=run_id,
        plant=scenario.name,
        inverters=tree.inverters,
        start_time_ns=times[0].value,
        cycle_ns=round(cycle_s * 1e9),
        cycles=len(times),
        cycle_wall_ns=0 if pace == "max" else round(cycle_s / pace * 1e9),
        period_cycles=_period_cycles(scenario_file, tree),
        alpha_min=scenario.control.alpha_min,
        hold_cycles=scenario.control.hold_cycles,
        stall_timeout_s=scenario.control.stall_timeout_s,
        neighbourhoods=_neighbourhoods(tree, covariance, order, times, hours),
        tcp_ports={},
    )
    profile = Profile(np.ascontiguousarray(mpp_kw[:, order]), commitment)
    return Preparation(plan, profile, scenario_file, scenario.neighbours.history == "hindsight")


def _times(scenario_file: ScenarioFile, options: RunOptions) -> pd.DatetimeIndex:
    table = scenario_file.scenario.time
    start = _start(local_start(table), options.start)
    duration_s = (
        parse_duration_s(options.duration, "--duration") if options.duration else table.duration_s
    )
    cycles = round(duration_s / table.cycle_s)
    if cycles < 1 or abs(cycles * table.cycle_s - duration_s) > 1e-6:
        raise InputError(
            f"duration of {duration_s:g} s: accepted are multiples of the cycle, "
            f"{table.cycle_s:g} s"
        )
    step = pd.Timedelta(seconds=table.cycle_s)
    first = pd.Timestamp(start).tz_convert("UTC")
    return pd.date_range(first, periods=cycles, freq=step, unit="ns")


def _start(scheduled: datetime, option: str | None) -> datetime:
    if option is None:
        return scheduled
    try:
        return datetime.combine(scheduled.date(), time.fromisoformat(option), scheduled.tzinfo)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(option)
    except ValueError:
        raise InputError(
            f"--start {option}: accepted is a local time such as 12:30 or 2010-04-01T12:30:00"
        ) from None
    return moment if moment.tzinfo else moment.replace(tzinfo=scheduled.tzinfo)


def _possible_power(
    scenario_file: ScenarioFile, times: pd.DatetimeIndex, options: RunOptions
) -> tuple[Sites, NDArray[np.float64]]:
    """Return the inverters, and the AC power that the irradiance allows each, shape (T, n)."""
    scenario = scenario_file.scenario
    match scenario.irradiance:
        case CloudIrradiance(seed=seed):
            sites = _listed_sites(scenario_file)
            used_seed = seed if options.seed is None else options.seed
            return sites, _synthetic_power(scenario_file, times, sites, used_seed)
        case MeasuredIrradiance() as measured:
            if options.seed is not None:
                raise InputError("--seed: the scenario's irradiance is measured, it has no seed")
            return _measured_power(scenario_file, measured, times)


def _listed_sites(scenario_file: ScenarioFile) -> Sites:
    plant = scenario_file.scenario.plant
    if plant.inverters is None:
        raise InputError(
            f"{scenario_file.path}: plant.inverters is missing, accepted is a CSV with the "
            "columns inverter, lat, lon"
        )
    return read_sites(scenario_file.data_path(plant.inverters), plant.rating_kw)


def _synthetic_power(
    scenario_file: ScenarioFile, times: pd.DatetimeIndex, sites: Sites, seed: int
) -> NDArray[np.float64]:
    scenario = scenario_file.scenario
    assert isinstance(scenario.irradiance, CloudIrradiance)
    ghi_wm2 = synthetic_ghi(
        times,
        sites.lat_deg,
        sites.lon_deg,
        scenario.plant.altitude_m,
        scenario.irradiance.clouds,
        seed,
    )
    return ac_power_kw(ghi_wm2, times, sites.lat_deg, sites.lon_deg, sites.rating_kw, scenario.pv)


def _measured_power(
    scenario_file: ScenarioFile, measured: MeasuredIrradiance, times: pd.DatetimeIndex
) -> tuple[Sites, NDArray[np.float64]]:
    scenario = scenario_file.scenario
    path = scenario_file.data_path(measured.ghi)
    irradiance = read_measured_ghi(
        path, scenario_file.data_path(measured.positions), measured.stations
    )
    cut = window(irradiance, times[0], len(times) * scenario.time.cycle_s, str(path))
    if len(cut.times) != len(times):
        step_s = (irradiance.times[1] - irradiance.times[0]).total_seconds()
        raise InputError(
            f"{path}: a value every {step_s:g} s, accepted is the scenario's cycle, "
            f"{scenario.time.cycle_s:g} s"
        )
    sites = Sites(
        tuple(f"inv{station}" for station in cut.sensors),
        cut.lat_deg,
        cut.lon_deg,
        equal_ratings_kw(scenario.plant.rating_kw, len(cut.sensors), str(scenario_file.path)),
    )
    power_kw = ac_power_kw(
        cut.ghi_wm2, times, sites.lat_deg, sites.lon_deg, sites.rating_kw, scenario.pv
    )
    return sites, power_kw


def _history_power(
    scenario_file: ScenarioFile,
    times: pd.DatetimeIndex,
    options: RunOptions,
    sites: Sites,
    mpp_kw: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Power of the inverters in the same hours of the past, from which neighbours are chosen."""
    scenario = scenario_file.scenario
    if scenario.neighbours.history == "hindsight":
        return mpp_kw
    if not isinstance(scenario.irradiance, CloudIrradiance):
        raise InputError(
            f"{scenario_file.path}: neighbours.history is 'earlier-day', accepted with measured "
            "irradiance is 'hindsight'"
        )
    seed = scenario.irradiance.seed if options.seed is None else options.seed
    return _synthetic_power(scenario_file, times, sites, seed + _ANOTHER_DAY)


def _clear_sky_power_kw(
    scenario_file: ScenarioFile, times: pd.DatetimeIndex, sites: Sites
) -> NDArray[np.float64]:
    """Power of the whole plant under a cloudless sky, shape (T,)."""
    scenario = scenario_file.scenario
    irradiance = scenario.irradiance
    turbidity = (
        irradiance.clouds.linke_turbidity if isinstance(irradiance, CloudIrradiance) else 3.0
    )
    ghi_wm2 = clear_sky_ghi(
        times, sites.lat_deg, sites.lon_deg, scenario.plant.altitude_m, turbidity
    )
    power_kw = ac_power_kw(
        np.repeat(ghi_wm2[:, None], len(sites.names), axis=1),
        times,
        sites.lat_deg,
        sites.lon_deg,
        sites.rating_kw,
        scenario.pv,
    )
    total_kw: NDArray[np.float64] = power_kw.sum(axis=1)
    return total_kw


def _control_tree(
    scenario_file: ScenarioFile, sites: Sites, covariance: HourlyMatrices
) -> ControlTree:
    """Cluster the inverters, the clusters, and so on up to the central controller."""
    groups: list[tuple[int, ...]] = [(index,) for index in range(len(sites.names))]
    paths = list(sites.names)
    control = scenario_file.scenario.control
    for tier, sizes in enumerate(control.cluster_sizes):
        if sum(sizes) != len(groups):
            raise InputError(
                f"{scenario_file.path}: control.cluster_sizes[{tier}] adds up to {sum(sizes)}, "
                f"accepted are sizes that add up to {len(groups)}"
            )
        members = _choose(control.clusters, sizes, groups, sites, covariance)
        paths = _prefixed(paths, groups, members, tier)
        groups = [tuple(leaf for place in cluster for leaf in groups[place]) for cluster in members]
    order = [leaf for group in groups for leaf in group]
    return as_ratings([paths[leaf] for leaf in order], [sites.rating_kw[leaf] for leaf in order])


def _choose(
    method: str,
    sizes: Sequence[int],
    groups: list[tuple[int, ...]],
    sites: Sites,
    covariance: HourlyMatrices,
) -> Sequence[Sequence[int]]:
    match method:
        case "correlation":
            mean = np.mean([group_correlation(hour, groups) for hour in covariance.values], axis=0)
            return choose_clusters(mean, sizes)
        case "geographic":
            east_m, north_m = _group_positions_m(groups, sites)
            return geographic_clusters(east_m, north_m, sizes)
        case _:
            bounds = np.cumsum([0, *sizes])
            return [range(low, high) for low, high in zip(bounds, bounds[1:], strict=False)]


def _group_positions_m(
    groups: list[tuple[int, ...]], sites: Sites
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    metres_per_degree = 111_200.0
    east_m = sites.lon_deg * metres_per_degree * np.cos(np.radians(sites.lat_deg.mean()))
    north_m = sites.lat_deg * metres_per_degree
    return (
        np.array([east_m[list(group)].mean() for group in groups]),
        np.array([north_m[list(group)].mean() for group in groups]),
    )


def _prefixed(
    paths: list[str], groups: list[tuple[int, ...]], members: Sequence[Sequence[int]], tier: int
) -> list[str]:
    letter = _TIER_LETTERS[tier] if tier < len(_TIER_LETTERS) else f"t{tier}_"
    prefixed = list(paths)
    for number, cluster in enumerate(members, start=1):
        for place in cluster:
            for leaf in groups[place]:
                prefixed[leaf] = f"{letter}{number}/{paths[leaf]}"
    return prefixed


def _period_cycles(scenario_file: ScenarioFile, tree: ControlTree) -> tuple[int, ...]:
    tiers = 1 + max(depth(parent) for parent in tree.parents)
    periods = scenario_file.scenario.control.period_cycles or (1,) * tiers
    if len(periods) != tiers:
        raise InputError(
            f"{scenario_file.path}: control.period_cycles has {len(periods)} entries, accepted is "
            f"one for each of the {tiers} tiers that have children"
        )
    return Periods(tuple(periods)).cycles


def _local_hours(times: pd.DatetimeIndex, timezone: str) -> NDArray[np.int64]:
    """Hours of local time since 1970, so that each hour of a run is one of its own."""
    local = times.tz_convert(timezone).tz_localize(None)
    return (local.as_unit("ns").asi8 // 3_600_000_000_000).astype(np.int64)


def _neighbourhoods(
    tree: ControlTree,
    covariance: HourlyMatrices,
    order: list[int],
    times: pd.DatetimeIndex,
    hours: NDArray[np.int64],
) -> tuple[NodeNeighbourhoods, ...]:
    """Correlation between each parent's children, for each hour of the run."""
    began = {int(hour): times[int(np.argmax(hours == hour))].value for hour in np.unique(hours)}
    return tuple(
        NodeNeighbourhoods(
            parent,
            tuple(
                Neighbourhood(
                    began[hour],
                    _child_correlation(tree, parent, covariance.at(hour)[np.ix_(order, order)]),
                )
                for hour in covariance.hours
            ),
        )
        for parent in tree.parents
    )


def _child_correlation(
    tree: ControlTree, parent: str, covariance: NDArray[np.float64]
) -> tuple[tuple[float, ...], ...]:
    groups = [tree.leaves_below(child) for child in tree.children(parent)]
    return tuple(tuple(row) for row in group_correlation(covariance, groups).tolist())
