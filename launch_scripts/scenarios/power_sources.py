"""From the irradiance that a scenario asks for to the source of its inverters' power."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from bus_schemas.errors import InputError
from launch_scripts.scenarios.scenario import (
    CloudIrradiance,
    DcCurrents,
    MeasuredIrradiance,
    OahuGridIrradiance,
    ScenarioFile,
    local_start,
)
from sim_plant import oahu_grid
from sim_plant.dc_current import ac_power_kw, read_currents
from sim_plant.irradiance import Irradiance, read_measured_ghi
from sim_plant.positions import placed_on_the_equator
from sim_plant.sites import Sites, equal_ratings_kw, inverter_name, read_sites
from sim_plant.sources import CloudySky, MeasuredPlant, MeasuredSky, PowerSource


def power_source(
    scenario_file: ScenarioFile, seed: int | None, times: pd.DatetimeIndex
) -> PowerSource:
    """Read what the scenario names, or make the sky that it describes."""
    irradiance = scenario_file.scenario.irradiance
    if seed is not None and not isinstance(irradiance, CloudIrradiance):
        raise InputError("--seed: expected a scenario with synthetic clouds, got a measured one")
    inverters = scenario_file.scenario.plant.inverters
    if inverters is not None and not isinstance(irradiance, CloudIrradiance):
        raise InputError(
            "plant.inverters: expected none with measured data, which says where the inverters "
            f"are, got {inverters!r}"
        )
    match irradiance:
        case CloudIrradiance():
            return _cloudy_sky(scenario_file, irradiance, seed)
        case MeasuredIrradiance():
            return _measured_sky(scenario_file, irradiance)
        case OahuGridIrradiance():
            return _oahu_sky(scenario_file, irradiance, times)
        case DcCurrents():
            return _measured_plant(scenario_file, irradiance)


def _cloudy_sky(scenario_file: ScenarioFile, table: CloudIrradiance, seed: int | None) -> CloudySky:
    plant = scenario_file.scenario.plant
    if plant.inverters is None:
        raise InputError(
            "plant.inverters: expected a CSV with the columns inverter, lat, lon, got nothing"
        )
    return CloudySky(
        sites=read_sites(scenario_file.data_path(plant.inverters), plant.rating_kw),
        altitude_m=plant.altitude_m,
        pv=scenario_file.scenario.pv,
        clouds=table.clouds,
        seed=table.seed if seed is None else seed,
        history_seed=table.seed,
    )


def _measured_sky(scenario_file: ScenarioFile, table: MeasuredIrradiance) -> MeasuredSky:
    path = scenario_file.data_path(table.ghi)
    irradiance = read_measured_ghi(path, scenario_file.data_path(table.positions), table.stations)
    sites = _at_the_sensors(scenario_file, irradiance, len(irradiance.sensors))
    scenario = scenario_file.scenario
    return MeasuredSky(sites, scenario.plant.altitude_m, scenario.pv, irradiance, str(path))


def _oahu_sky(
    scenario_file: ScenarioFile, table: OahuGridIrradiance, times: pd.DatetimeIndex
) -> MeasuredSky:
    """Read the day of the run, and the latest before it where the past is asked for."""
    scenario = scenario_file.scenario
    folder = scenario_file.data_path(table.folder) if table.folder else scenario_file.data_folder
    if not (any(folder.glob("*.txt")) or any(folder.glob("*.zip"))):
        raise InputError(
            "irradiance.folder: expected daily files (YYYYMMDD.txt or YYYYMM.zip) there or in the "
            f"folder of --data, got none in {folder}"
        )
    positions = scenario_file.data_path(table.positions)
    most_missing = None if table.gaps == "refuse" else table.most_missing
    day = times[0].tz_convert(oahu_grid.TIMEZONE).date()
    run = oahu_grid.read_day(folder, day, positions, table.stations, most_missing)
    stations = len(oahu_grid.HORIZONTAL if table.stations is None else table.stations)
    sites = _at_the_sensors(scenario_file, run.irradiance, stations)
    plant = (sites, scenario.plant.altitude_m, scenario.pv)
    sky = MeasuredSky(*plant, run.irradiance, run.source, run.report)
    if scenario.neighbours.history == "hindsight":
        return sky
    before = oahu_grid.latest_day_before(folder, day)
    # The plant is that of the run's day, however little of a sensor the earlier day has.
    fill = None if most_missing is None else 1.0
    past = oahu_grid.read_day(folder, before, positions, run.irradiance.sensors, fill)
    earlier = MeasuredSky(*plant, past.irradiance, past.source, past.report)
    return replace(sky, earlier=earlier, earlier_by=day - before)


def _at_the_sensors(scenario_file: ScenarioFile, irradiance: Irradiance, stations: int) -> Sites:
    """Put one inverter at each sensor; a station without a sensor takes its share away."""
    rating_kw = equal_ratings_kw(scenario_file.scenario.plant.rating_kw, stations, "plant")
    return Sites(
        tuple(inverter_name(station) for station in irradiance.sensors),
        irradiance.lat_deg,
        irradiance.lon_deg,
        rating_kw[: len(irradiance.sensors)],
    )


def _measured_plant(scenario_file: ScenarioFile, table: DcCurrents) -> MeasuredPlant:
    """Take the power of a real plant's inverters from their currents."""
    scenario = scenario_file.scenario
    path = scenario_file.data_path(table.currents)
    currents = read_currents(
        path,
        scenario_file.data_path(table.positions),
        table.full_power_current,
        refuse_gaps=table.gaps == "refuse",
    )
    # An inverter that is left out takes its rating away.
    rating_kw = equal_ratings_kw(scenario.plant.rating_kw, currents.listed, "plant")
    sites = Sites(
        tuple(inverter_name(inverter) for inverter in currents.inverters),
        *placed_on_the_equator(currents.x_m, currents.y_m),
        rating_kw[: len(currents.inverters)],
    )
    begins = pd.Timestamp(local_start(scenario.time)).tz_convert("UTC").as_unit("ns")
    return MeasuredPlant(
        sites,
        begins + pd.to_timedelta(currents.time_ns, unit="ns"),
        ac_power_kw(currents.share, sites.rating_kw),
        str(path),
        currents.report,
    )
