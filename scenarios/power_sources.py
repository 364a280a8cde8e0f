"""From the irradiance that a scenario asks for to the source of its inverters' power."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import pandas as pd

from bus_schemas.errors import InputError
from scenarios.scenario import (
    CloudIrradiance,
    DcCurrents,
    MeasuredIrradiance,
    OahuGridIrradiance,
    ScenarioFile,
    local_start,
    zoned,
)
from sim_plant import oahu_grid
from sim_plant.clear_sky import doubts_of
from sim_plant.dc_current import read_currents
from sim_plant.irradiance import Irradiance, read_measured_ghi
from sim_plant.sites import Sites, equal_ratings_kw, inverter_names, read_sites
from sim_plant.sources import CloudySky, MeasuredPlant, PlantUnderSky, PowerSource, measured_sky


def power_source(
    scenario_file: ScenarioFile,
    seed: int | None,
    times: pd.DatetimeIndex,
    own_times: pd.DatetimeIndex,
    *,
    keeps: bool = False,
    read: Irradiance | None = None,
) -> PowerSource:
    """Read what the scenario names, or make the sky that it describes; keep what that brings.

    `times` are those of the run, `own_times` those of the scenario; `read` is what was read before.
    """
    irradiance = scenario_file.scenario.irradiance
    plant = scenario_file.scenario.plant
    is_drawn = isinstance(irradiance, CloudIrradiance)
    if not is_drawn and (plant.inverters or plant.grid or plant.block_m > 0.0):
        expected = "none with measured data, which says where inverters are and what they see"
        raise InputError.of("plant.inverters, plant.grid, plant.block_m", f"expected {expected}")
    match irradiance:
        case CloudIrradiance():
            return _cloudy_sky(scenario_file, irradiance, seed, keeps=keeps)
        case MeasuredIrradiance():
            return _measured_sky(scenario_file, irradiance, own_times.union(times), read)
        case OahuGridIrradiance():
            return _oahu_sky(scenario_file, irradiance, times)
        case DcCurrents():
            return _measured_plant(scenario_file, irradiance)


def _cloudy_sky(
    scenario_file: ScenarioFile, table: CloudIrradiance, seed: int | None, *, keeps: bool
) -> CloudySky:
    plant, time = scenario_file.scenario.plant, scenario_file.scenario.time
    clear_until = table.clear_until
    if (plant.inverters is None) == (plant.grid is None):
        raise InputError.of(
            "plant.inverters", "expected a CSV with the columns inverter, lat, lon, or plant.grid"
        )
    return CloudySky(
        sites=plant.grid.sites(plant.rating_kw)
        if plant.grid is not None
        else read_sites(scenario_file.data_path(plant.inverters or ""), plant.rating_kw),
        altitude_m=plant.altitude_m,
        pv=scenario_file.scenario.pv,
        clouds=table.clouds,
        seed=table.seed if seed is None else seed,
        history_seed=table.seed,
        block_m=plant.block_m,
        clear_until=None
        if clear_until is None
        else pd.Timestamp(zoned(clear_until, time, "irradiance.clear_until")),
        is_kept=keeps,
    )


def _measured_sky(
    scenario_file: ScenarioFile,
    table: MeasuredIrradiance,
    wanted: pd.DatetimeIndex,
    read: Irradiance | None,
) -> MeasuredPlant:
    path, positions = (scenario_file.data_path(name) for name in (table.ghi, table.positions))
    zone = table.timezone or scenario_file.scenario.time.timezone
    form = msgspec.structs.replace(table, timezone=zone)
    found = read or read_measured_ghi(path, positions, table.stations, table.max_gap_s, form)
    doubts = tuple(f"warning: {path.name}: {one}" for one in doubts_of(found))
    sky = _at_the_sensors(scenario_file, found, len(found.sensors))
    return measured_sky(sky, replace(found, report=found.report + doubts), wanted)


def _oahu_sky(
    scenario_file: ScenarioFile, table: OahuGridIrradiance, times: pd.DatetimeIndex
) -> MeasuredPlant:
    """Read the day of the run, and the latest before it where the past is asked for."""
    scenario = scenario_file.scenario
    folder = scenario_file.data_path(table.folder) if table.folder else scenario_file.data_folder
    if not any(folder.glob("*.txt")):
        raise InputError.of(
            "irradiance.folder",
            "expected daily files YYYYMMDD.txt (unzip the archive's months) "
            f"there or in the folder of --data, got none in {folder}",
        )
    positions = scenario_file.data_path(table.positions)
    day = times[0].tz_convert(oahu_grid.TIMEZONE).date()
    irradiance = oahu_grid.read_day(folder, day, positions, table.stations, table.most_missing)
    stations = len(oahu_grid.HORIZONTAL if table.stations is None else table.stations)
    sky = _at_the_sensors(scenario_file, irradiance, stations)
    plant = measured_sky(sky, irradiance)
    if scenario.neighbours.history == "hindsight":
        return plant
    before = oahu_grid.latest_day_before(folder, day)
    # The plant is that of the run's day, however little of a sensor the earlier day has.
    past = oahu_grid.read_day(folder, before, positions, irradiance.sensors, most_missing=1.0)
    return replace(plant, earlier=measured_sky(sky, past), earlier_by=day - before)


def _at_the_sensors(
    scenario_file: ScenarioFile, irradiance: Irradiance, stations: int
) -> PlantUnderSky:
    """Put one inverter at each sensor; a station without a sensor takes its share away."""
    scenario = scenario_file.scenario
    sites = Sites(
        inverter_names(irradiance.sensors),
        irradiance.coordinates["lat"].to_numpy(),
        irradiance.coordinates["lon"].to_numpy(),
        equal_ratings_kw(scenario.plant.rating_kw, stations, "plant")[: len(irradiance.sensors)],
    )
    return PlantUnderSky(sites, scenario.plant.altitude_m, scenario.pv)


def _measured_plant(scenario_file: ScenarioFile, table: DcCurrents) -> MeasuredPlant:
    """Take the power of a real plant's inverters from their currents."""
    scenario = scenario_file.scenario
    measured = read_currents(
        scenario_file.data_path(table.currents),
        scenario_file.data_path(table.positions),
        table.full_power_current,
        pd.Timestamp(local_start(scenario.time)).tz_convert("UTC").as_unit("ns"),
        scenario.plant.rating_kw,
        table.place,
    )
    if table.place is None:
        return measured
    sky = PlantUnderSky(measured.sites, scenario.plant.altitude_m, scenario.pv)
    return replace(measured, sky=sky)
