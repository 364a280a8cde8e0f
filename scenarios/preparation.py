"""Works out, before anything starts, all that a run needs: from a scenario to plan and profile."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.control.correlation import HourlyMatrices, hourly_deviations
from agents.device_profile import PLAIN
from agents.plan import RunPlan
from agents.plan_file import check_plan, check_size
from agents.plan_parts import (
    Access,
    Control,
    Faults,
    NodeNeighbourhoods,
    Site,
    Supervision,
    Timing,
)
from agents.settings import (
    FleetPlant,
    InverterSettings,
    OfferedCommitment,
    Revert,
    StorageSettings,
)
from bus_schemas.errors import InputError
from bus_schemas.tree import OPERATOR, ROOT, ControlTree
from scenarios.clustering import between, control_tree, neighbourhoods, with_storages
from scenarios.elsewhere import (
    METER_NODE,
    addresses_of,
    check_base_port,
    external_agents,
    read_address,
    real_devices,
)
from scenarios.fault_rules import fault_rules
from scenarios.fleet import SEEDS_APART, Member, members, named_plant
from scenarios.power_sources import power_source
from scenarios.real_time import cycle_wall_ns, machine_settings, parse_pace, process_groups
from scenarios.run_options import RunOptions, parse_split
from scenarios.scenario import CloudIrradiance, Scenario, ScenarioFile, local_start
from scenarios.times import LONGEST_S, Cycle, When, on_day, parse_duration_s, parse_moment
from sim_plant.commitment import commitment_kw, is_hindsight
from sim_plant.frequency import frequency_hz
from sim_plant.irradiance import Irradiance
from sim_plant.profile import Profile
from sim_plant.regulation import regulation_kw
from sim_plant.sites import Sites, east_north_m
from sim_plant.sources import MeasuredPlant, PowerSource

__all__ = ["Preparation", "RunOptions", "prepare"]

_HOUR_NS: Final = 3_600_000_000_000

_FINEST_PAST_S: Final = 1.0
"""Finest step of the past: shorter ones add nothing, since clouds change over seconds."""

_LARGEST_DISTANCE_M: Final = 100_000.0
"""Farther from the middle than in any plant: a larger distance is probably a mistyped position."""


@dataclass(frozen=True, slots=True)
class Preparation:
    """A run that is ready to start."""

    plan: RunPlan
    profile: Profile
    scenario: ScenarioFile
    options: RunOptions
    remarks: tuple[str, ...]

    def local_start(self) -> str:
        """Return the local time of cycle 0, to be read."""
        moment = pd.Timestamp(self.plan.timing.start_time_ns, tz="UTC")
        return f"{moment.tz_convert(self.plan.timing.timezone):%Y-%m-%d %H:%M:%S %Z}"

    def title(self) -> str:
        """Return which part of which scenario is run, to be read."""
        plan = self.plan
        length = f"{plan.timing.cycles:,} cycles of {plan.timing.cycle_ns / 1e9:g} s"
        return f"{plan.plant} from {self.local_start()}, {length}"


@dataclass(frozen=True, slots=True)
class _Day:
    """Power of a run, and its control tree.

    Columns of `mpp_kw` and `meter_error`, and rows of `lat_lon_deg`, are inverters of the tree.
    `history_kw` has, by the beginning of an hour of the run, the deviations of the power of all in
    the past. `settings` are those of its inverters.
    """

    times: pd.DatetimeIndex
    tree: ControlTree
    mpp_kw: NDArray[np.float64]
    available_kw: NDArray[np.float64]
    meter_error: NDArray[np.float64]
    lat_lon_deg: NDArray[np.float64]
    neighbourhoods: tuple[NodeNeighbourhoods, ...]
    history_kw: dict[int, NDArray[np.float64]]
    clear_sky_kw: Callable[[pd.DatetimeIndex], NDArray[np.float64]]
    remarks: tuple[str, ...]
    settings: tuple[InverterSettings, ...]
    storages: tuple[StorageSettings, ...]
    plants: tuple[FleetPlant, ...] = ()

    @property
    def positions_m(self) -> tuple[tuple[float, float], ...]:
        """Metres east and north of the middle of each inverter."""
        both = np.column_stack(east_north_m(*self.lat_lon_deg.T))
        return tuple((float(east), float(north)) for east, north in (both - both.mean(0)).round(2))


def prepare(
    scenario_file: ScenarioFile,
    options: RunOptions,
    run_id: str,
    *,
    keeps: bool = False,
    read: Irradiance | None = None,
) -> Preparation:
    """Work out a run; whatever can be wrong with its options is checked first.

    `keeps`: The next run under the same sky need not work it out once more. `read`: The measured
    irradiance of the scenario, where it was read before.
    """
    scenario = scenario_file.scenario
    if options.cycle_s is not None:
        scenario = replace(scenario, time=replace(scenario.time, cycle_s=options.cycle_s))
    if options.seed is not None and not isinstance(scenario.irradiance, CloudIrradiance):
        raise InputError.of(
            "--seed", "expected a scenario with synthetic clouds, got measured data"
        )
    path, pace = scenario_file.path, parse_pace(options.pace) or scenario.pace
    times, remarks_on_time = _times(scenario_file, scenario, options)
    wall_ns = cycle_wall_ns(
        scenario.time.cycle_s, pace, "--pace" if options.pace else f"{path}: pace"
    )
    if options.priority is not None and pace == "max":
        why = "got lockstep, where nothing can be late"
        raise InputError.of("--priority", f"expected a --pace such as 1 with it, {why}")
    keys_folder, offer = _keys_folder(scenario, options), scenario.regulation
    with scenario_file.named():
        day = _day(scenario_file, scenario, options.seed, times, keeps=keeps, read=read)
        commitment = commitment_kw(
            scenario.commitment,
            times,
            day.available_kw,
            day.clear_sky_kw,
            scenario_file.data_path,
            scenario.time.timezone,
        )
        regulation, regulation_notes = np.zeros(len(times)), tuple[str, ...]()
        if offer is not None:
            zone, data_path = scenario.time.timezone, scenario_file.data_path
            regulation, regulation_notes = regulation_kw(offer, times, zone, data_path)
        frequency, frequency_notes = _frequency_hz(scenario_file, scenario, times)
    plan = _plan(scenario_file, scenario, options, run_id, day, wall_ns, keys_folder)
    remarks = [*remarks_on_time, *day.remarks, *_too_much(commitment, plan.tree)]
    remarks += regulation_notes + frequency_notes
    hides_maximum = plan.control.actuator == "limit" and not plan.site.states_all
    if plan.grid_law.reserve_kw > 0.0 and hides_maximum:
        remarks.append(
            "warning: grid.droop.reserve_percent: expected plant.available_bias with it; behind "
            "power limits a reserve fades once it holds the plant below its dispatch"
        )
    if plan.site.revert != scenario.plant.revert:
        remarks.append(
            f"inverters revert after {plan.site.revert.after_s:g} s, which is three cycles"
        )
    if scenario.neighbours.history == "hindsight":
        remarks.append("Clusters and neighbours were chosen from the run's own data: hindsight.")
    if is_hindsight(scenario.commitment):
        remarks.append("The commitment follows from the run's own available power: hindsight.")
    profile = Profile(
        day.mpp_kw,
        commitment,
        regulation,
        plan.site.regulation_capacity_kw,
        meter_error=day.meter_error,
        clear_sky_kw=day.clear_sky_kw(day.times) if plan.control.offers else np.zeros(0),
        frequency_hz=frequency,
    )
    return Preparation(plan, profile, scenario_file, options, tuple(remarks))


def _day(
    scenario_file: ScenarioFile,
    scenario: Scenario,
    seed: int | None,
    times: pd.DatetimeIndex,
    *,
    keeps: bool,
    read: Irradiance | None = None,
    member: Member | None = None,
) -> _Day:
    if scenario.plants:
        return _fleet_day(scenario_file, scenario, seed, times, keeps=keeps)
    own = scenario_file.scenario  # Clusters and neighbours are its own, whatever the options.
    own_times, _ = _times(scenario_file, own, RunOptions())
    source = power_source(scenario_file, seed, times, own_times, keeps=keeps, read=read)
    source = source if member is None else member.placed(source)
    check_size(len(times), len(source.sites.names), "time.duration_s")
    available_kw = source.available_kw(times)
    deviations = _deviations(own, own_times, source, times)
    of_scenario = _local_hours(own_times, own.time.timezone)
    # Hours without a past cannot decide on clusters, unless there are no others.
    hours = sorted(set(of_scenario.tolist()).intersection(deviations))
    tree = control_tree(scenario.control, source.sites, deviations, hours or list(deviations))
    tree = with_storages(tree, scenario.storage)
    place_of = {name: place for place, name in enumerate(source.sites.names)}
    order = [place_of[leaf.rpartition("/")[2]] for leaf in tree.leaves]
    beginnings = _beginnings_ns(times, scenario)
    # The same errors in each run.
    meter = np.random.default_rng(scenario.plant.meter_seed + (member.number if member else 0))
    warnings = _warnings(source.sites, available_kw)
    return _Day(
        times=times,
        tree=tree,
        mpp_kw=np.ascontiguousarray(available_kw[:, order]),
        available_kw=available_kw.sum(axis=1),
        meter_error=scenario.plant.meter_noise * meter.standard_normal(available_kw.shape),
        lat_lon_deg=np.column_stack((source.sites.lat_deg, source.sites.lon_deg))[order],
        neighbourhoods=neighbourhoods(tree, deviations, order, beginnings),
        history_kw={ns: deviations[hour].sum(axis=1) for hour, ns in beginnings.items()},
        clear_sky_kw=source.clear_sky_kw,
        remarks=(*(f"warning: {one}" for one in warnings), *source.remarks),
        settings=scenario.plant.settings,
        storages=scenario.storage,
    )


def _fleet_day(
    scenario_file: ScenarioFile,
    scenario: Scenario,
    seed: int | None,
    times: pd.DatetimeIndex,
    *,
    keeps: bool,
) -> _Day:
    """Work out the days of all plants of a fleet, and join them."""
    days: list[tuple[Member, _Day]] = []
    for member in members(scenario_file):
        own = member.file.scenario
        own = replace(own, time=replace(own.time, cycle_s=scenario.time.cycle_s))
        with named_plant(member.number):
            own_seed = None if seed is None else seed + SEEDS_APART * member.number
            day = _day(member.file, own, own_seed, times, keeps=keeps, member=member)
            days.append((member, day))
    check_size(len(times), sum(len(day.tree.leaves) for _, day in days), "time.duration_s")
    parts = [day for _, day in days]
    plants = tuple(member.plant(day.tree) for member, day in days)
    storages = tuple(one for member, _ in days for one in member.storages()) + scenario.storage
    tree = ControlTree(
        tuple(
            (member.path(path), rating_kw)
            for member, day in days
            for path, rating_kw in day.tree.inverters
        ),
        plants=tuple((one.name, one.export_limit_kw) for one in plants),
    )
    noted: dict[str, list[str]] = {}
    for member, day in days:
        for one in day.remarks:
            noted.setdefault(one, []).append(member.entry.name)

    def feedable(powers_kw: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        limits_kw = [one.export_limit_kw for one in plants]
        found: NDArray[np.float64] = np.sum([*map(np.minimum, powers_kw, limits_kw)], axis=0)
        return found

    of_plants = (
        replace(hood, node=member.path(hood.node))
        for member, day in days
        for hood in day.neighbourhoods
    )
    return _Day(
        times=times,
        tree=with_storages(tree, storages),
        mpp_kw=np.hstack([day.mpp_kw for day in parts]),
        available_kw=feedable([day.available_kw for day in parts]),
        meter_error=np.hstack([day.meter_error for day in parts]),
        lat_lon_deg=np.vstack([day.lat_lon_deg for day in parts]),
        neighbourhoods=(*of_plants, between([day.history_kw for day in parts])),
        history_kw={},
        clear_sky_kw=lambda when: feedable([day.clear_sky_kw(when) for day in parts]),
        remarks=(
            *(f"{', '.join(names)}: {one}" for one, names in noted.items()),
            *_on_one_spot(days),
        ),
        settings=tuple(one for member, _ in days for one in member.settings()),
        storages=storages,
        plants=plants,
    )


def _on_one_spot(days: Sequence[tuple[Member, _Day]]) -> Iterator[str]:
    """Warn of plants that see different clouds at the same place."""
    found: dict[tuple[float, ...], list[Member]] = {}
    for member, day in days:
        if isinstance(member.file.scenario.irradiance, CloudIrradiance):
            middle = tuple(day.lat_lon_deg.mean(axis=0).round(4).tolist())  # Within some 10 m.
            found.setdefault(middle, []).append(member)
    for plants in found.values():
        if len({one.file.scenario.irradiance for one in plants}) > 1:
            names = ", ".join(one.entry.name for one in plants)
            yield f"warning: plants: expected lat and lon for each sky, got {names} on one spot"


def _frequency_hz(
    scenario_file: ScenarioFile, scenario: Scenario, times: pd.DatetimeIndex
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the frequency in each cycle, none where nobody asks for it, and notes on its file."""
    nominal_hz, settings = scenario.grid.nominal_hz, scenario.frequency
    if settings is None and scenario.grid.droop is None:
        return np.zeros(0), ()
    cycle_s, find_file = scenario.time.cycle_s, scenario_file.data_path
    begins = times[0].tz_convert(scenario.time.timezone)
    return frequency_hz(settings, len(times), cycle_s, nominal_hz, find_file, begins)


def _too_much(commitment_kw: NDArray[np.float64], tree: ControlTree) -> Iterator[str]:
    rating_kw, highest_kw = tree.rating_kw(ROOT), commitment_kw.max()
    if highest_kw > rating_kw * (1.0 + 1e-9):
        yield (
            f"warning: commitment: expected the plant's rating of {rating_kw:,.0f} kW at most, got "
            f"{highest_kw:,.0f} kW"
        )


def _warnings(sites: Sites, available_kw: NDArray[np.float64]) -> Iterator[str]:
    """Warn of what can be run but is probably a mistake."""
    away_m = np.hypot(*east_north_m(sites.lat_deg, sites.lon_deg))
    farthest = int(away_m.argmax())
    if away_m[farthest] > _LARGEST_DISTANCE_M:
        yield (
            f"plant: expected inverters within {_LARGEST_DISTANCE_M / 1e3:g} km of its middle, got "
            f"{sites.names[farthest]} {away_m[farthest] / 1e3:,.0f} km away; check lat and lon"
        )
    if not available_kw.any():
        yield (
            "time: expected a run by day, got one without any sun; check time.start, "
            "time.timezone and the positions of the inverters"
        )


def _plan(
    scenario_file: ScenarioFile,
    scenario: Scenario,
    options: RunOptions,
    run_id: str,
    day: _Day,
    wall_ns: int,
    keys_folder: str,
) -> RunPlan:
    with scenario_file.named():
        groups = process_groups(scenario.processes, day.tree)
    external = external_agents(options.external or (), day.tree)
    if OPERATOR in external and not keys_folder:
        raise InputError.of(
            "--external operator",
            "expected --secure with it, since any program of this host could give orders",
        )
    addresses = addresses_of(
        options.on or (), day.tree, external, options.address, secure=bool(keys_folder)
    )
    where = f"{scenario_file.path}: devices"
    devices = real_devices(scenario.devices, where, options.devices or (), day.tree)
    file_s, file_bytes = parse_split(options.split)
    plan = RunPlan(
        run_id=run_id,
        plant=scenario.name,
        inverters=day.tree.inverters,
        timing=_timing(scenario, day, wall_ns),
        control=_control(scenario, options, day),
        site=_site(scenario, options, day, devices),
        access=Access(  # The launcher chooses the ports.
            # With fixed ports the namespace is fixed too, so that a device is configured once.
            namespace=scenario.name if options.base_port is not None else "",
            external=external,
            address=options.address,
            addresses=addresses,
            keys_folder=keys_folder,
        ),
        faults=Faults(
            fault_rules(scenario_file, options.faults or (), day.tree, external, addresses),
            scenario.faults_seed,
        ),
        supervision=Supervision(
            restart=scenario.restart,
            machine=machine_settings(options.cpus or (), options.priority),
            groups=groups,
            file_cycles=max(round(file_s / scenario.time.cycle_s), 1) if file_s else 0,
            file_bytes=file_bytes,
        ),
        grid=scenario.grid,
        orders=scenario.orders,
        storages=day.storages,
        plants=day.plants,
    )
    with scenario_file.named():
        check_plan(plan)
    if options.base_port is not None:
        check_base_port(options.base_port, plan)
    return plan


def _timing(scenario: Scenario, day: _Day, wall_ns: int) -> Timing:
    return Timing(
        start_time_ns=day.times[0].value,
        cycle_ns=round(scenario.time.cycle_s * 1e9),
        cycles=len(day.times),
        timezone=scenario.time.timezone,
        cycle_wall_ns=wall_ns,
        stall_timeout_s=scenario.control.stall_timeout_s,
    )


def _control(scenario: Scenario, options: RunOptions, day: _Day) -> Control:
    control, offered = scenario.control, scenario.commitment
    scheme = options.scheme or control.scheme
    return Control(
        period_cycles=control.period_cycles or (1,) * day.tree.height,
        scheme=scheme,
        actuator=options.actuator or scenario.plant.actuator,
        alpha_min=control.alpha_min,
        hold_cycles=control.hold_cycles,
        neighbourhoods=day.neighbourhoods,
        correction=scheme == "predictive" if control.correction is None else control.correction,
        offset_kw=control.offset * day.tree.rating_kw(ROOT),
        offset_errors=control.offset_errors,
        storage=control.storage,
        offers=offered if isinstance(offered, OfferedCommitment) else None,
    )


def _site(
    scenario: Scenario, options: RunOptions, day: _Day, devices: Sequence[tuple[str, str]]
) -> Site:
    seed = options.seed
    if seed is None and isinstance(scenario.irradiance, CloudIrradiance):
        seed = scenario.irradiance.seed
    return Site(
        seed=seed,
        regulation_capacity_kw=scenario.regulation.capacity_kw if scenario.regulation else 0.0,
        ramp_limit_percent_per_min=scenario.plant.ramp_limit_percent_per_min,
        available_bias=scenario.plant.available_bias,
        available_share=scenario.plant.available_share,
        revert=_renewable(scenario.plant.revert, scenario),
        ramp_percent_per_s=scenario.plant.ramp_percent_per_s,
        delay_s=scenario.plant.delay_s,
        settings=tuple(
            replace(entry, revert=entry.revert and _renewable(entry.revert, scenario))
            for entry in day.settings
        ),
        devices=tuple(pair for pair in devices if pair[0] != METER_NODE),
        meter=dict(devices).get(METER_NODE, ""),
        profiles=tuple(
            (table.node, table.profile) for table in scenario.devices if table.profile != PLAIN
        ),
        positions_m=day.positions_m,
    )


def _renewable(revert: Revert, scenario: Scenario) -> Revert:
    """Let a revert time be three cycles at least: commands are renewed within a third of it."""
    return replace(revert, after_s=max(revert.after_s, 3.0 * scenario.time.cycle_s))


def _keys_folder(scenario: Scenario, options: RunOptions) -> str:
    """Return the folder of the keys; empty: the links are not encrypted."""
    address = read_address(options.address)
    if not options.secure:
        if options.keys is not None:
            raise InputError.of("--keys", "expected --secure with it")
        if not address.is_loopback:
            raise InputError.of(
                f"--address {options.address}",
                "expected --secure with it, since anyone who reaches "
                "that address could command the plant",
            )
        return ""
    return str((options.keys or Path("keys") / scenario.name).absolute())


def _times(
    scenario_file: ScenarioFile, scenario: Scenario, options: RunOptions
) -> tuple[pd.DatetimeIndex, tuple[str, ...]]:
    """Return the beginnings of the cycles, and a remark if the first one is a time that repeats."""
    table = scenario.time
    with scenario_file.named():
        own = local_start(table)
        starts = on_day(table.start, own, "time.start")
    cycle_s = table.cycle_s
    if options.start is not None:
        starts = _moments(options.start, "--from", own, own, cycle_s)
    start = starts[0]
    where, duration_s = "time.duration_s", table.duration_s
    if options.duration is not None:
        where = "--duration"
        duration_s = parse_duration_s(options.duration, where, cycle_s)
    if options.end is not None:
        where, ends = "--to", _moments(options.end, "--to", start, own, cycle_s)
        # In UTC: between two times of one zone Python counts the hours of the wall clock.
        lengths_s = [(end.astimezone(UTC) - start.astimezone(UTC)).total_seconds() for end in ends]
        duration_s = next((one for one in lengths_s if one > 0.0), 0.0)
        if duration_s <= 0.0:
            raise InputError.of(where, f"expected a time after {start:%H:%M:%S}, got {options.end}")
    with scenario_file.named() if where == "time.duration_s" else nullcontext():
        cycles = round(duration_s / cycle_s)
        if cycles < 1 or abs(cycles * cycle_s - duration_s) > 1e-6:
            expected = f"a whole number of cycles of {cycle_s:g} s"
            raise InputError.of(where, f"expected {expected}, got {duration_s:g} s")
        check_size(cycles, 1, where)
    first = pd.Timestamp(start).tz_convert("UTC")
    times = pd.date_range(first, periods=cycles, freq=pd.Timedelta(seconds=cycle_s), unit="ns")
    return times, tuple(_of_two(starts))


def _moments(
    given: When, where: str, day: datetime, own_start: datetime, cycle_s: float
) -> tuple[datetime, ...]:
    """Return the times that an option may mean; seconds and cycles count from `own_start`."""
    moment = parse_moment(given, where)
    if isinstance(moment, time | datetime):
        return on_day(moment, day, where)
    since_s = moment.number * cycle_s if isinstance(moment, Cycle) else moment
    later = own_start.astimezone(UTC) + timedelta(seconds=min(since_s, 2 * LONGEST_S))
    return (later.astimezone(own_start.tzinfo),)


def _of_two(starts: Sequence[datetime]) -> Iterator[str]:
    """Say which one is taken of two times that the clocks show alike."""
    if len(starts) > 1:
        first, second = (one.strftime("%z") for one in starts)
        yield (
            f"{starts[0]:%Y-%m-%d %H:%M:%S} comes twice, since the clocks are put back: the first "
            f"one is taken, at {first}; {starts[1]:%Y-%m-%dT%H:%M:%S}{second} is the second"
        )


def _deviations(
    scenario: Scenario,
    own_times: pd.DatetimeIndex,
    source: PowerSource,
    times: pd.DatetimeIndex,
) -> HourlyMatrices:
    """Deviations of the inverters' power in the past, for the hours of scenario and run.

    Whichever part of the scenario is run, the plant keeps its clusters and neighbours.
    """
    found: HourlyMatrices = {}
    for past, power_kw in _past(scenario, own_times, source, times):
        found |= hourly_deviations(power_kw, _local_hours(past, scenario.time.timezone))
    return found


def _past(
    scenario: Scenario,
    own_times: pd.DatetimeIndex,
    source: PowerSource,
    times: pd.DatetimeIndex,
) -> Iterator[tuple[pd.DatetimeIndex, NDArray[np.float64]]]:
    """Yield times of the past that have no hour in common, and the power of each inverter then."""
    if scenario.neighbours.history == "hindsight":
        past = times if source.measured_times is None else source.measured_times
        yield past, source.available_kw(past)
    elif isinstance(source, MeasuredPlant):
        yield source.measured_times, source.earlier_day_kw(source.measured_times)
    else:
        step = pd.Timedelta(seconds=max(scenario.time.cycle_s, _FINEST_PAST_S))
        own, run = _whole_hours(own_times, step), _whole_hours(times, step)
        if max(own[0] - run[-1], run[0] - own[-1]) < pd.Timedelta(hours=1):
            own = own.union(run)
        else:
            yield run, source.earlier_day_kw(run)
        yield own, source.kept_day_kw(own)  # Of every day of a study the same.


def _whole_hours(times: pd.DatetimeIndex, step: pd.Timedelta) -> pd.DatetimeIndex:
    """Return times, in steps, over the whole of the hours that these times touch."""
    return pd.date_range(
        times[0].floor("h"),
        times[-1].floor("h") + pd.Timedelta(hours=1),
        freq=step,
        inclusive="left",
        unit="ns",
    )


def _local_hours(times: pd.DatetimeIndex, timezone: str) -> NDArray[np.int64]:
    """Return hours of local time since 1970, so that each hour of a run is one of its own."""
    local = times.tz_convert(timezone).tz_localize(None)
    return (local.as_unit("ns").asi8 // _HOUR_NS).astype(np.int64)


def _beginnings_ns(times: pd.DatetimeIndex, scenario: Scenario) -> dict[int, int]:
    """For each hour of the run the simulated time at which it begins [ns]."""
    hours, first = np.unique(_local_hours(times, scenario.time.timezone), return_index=True)
    return {int(hour): times[int(row)].value for hour, row in zip(hours, first, strict=True)}
