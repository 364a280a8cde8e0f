"""The plants of a fleet: each has the scenario that it names, in the time of the fleet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import replace as with_sites
from typing import Final
from zoneinfo import ZoneInfo

from msgspec.structs import replace

from agents.settings import FleetPlant, InverterSettings, StorageSettings
from bus_schemas.errors import InputError
from bus_schemas.tree import ControlTree, check_name
from scenarios.scenario import (
    CloudIrradiance,
    PlantEntry,
    ScenarioFile,
    load_scenario,
    local_start,
)
from scenarios.settings import with_settings
from sim_plant.pv import PvSettings
from sim_plant.sites import east_north_m, placed_around
from sim_plant.sources import CloudySky, PowerSource

SEEDS_APART: Final = 1000
"""Plants that name no seed get seeds so far apart: equal seeds would give equal skies."""

_SET: Final = (
    *("irradiance", "pv", "plant", "grid", "neighbours", "time.timezone"),
    *("control.clusters", "control.clusters_seed"),
)
"""Fields that a plant brings to its fleet, and tables of them."""

_OF_FLEET: Final = {
    "plant.actuator",
    "plant.available_share",
    "plant.ramp_limit_percent_per_min",
    "grid.nominal_hz",
}
"""Fields of those tables that the fleet alone has."""


@dataclass(frozen=True, slots=True)
class Member:
    """A plant of a fleet, and the scenario that it runs."""

    entry: PlantEntry
    number: int
    file: ScenarioFile

    def placed(self, source: PowerSource) -> PowerSource:
        """Return its power where it stands."""
        lat, lon = self.entry.lat, self.entry.lon
        if lat is None or lon is None:
            return source
        if not isinstance(source, CloudySky):
            raise InputError.of("lat", "expected none with measured data")
        metres = east_north_m(source.sites.lat_deg, source.sites.lon_deg)
        lat_deg, lon_deg = placed_around((lat, lon), *metres)
        return with_sites(source, sites=with_sites(source.sites, lat_deg=lat_deg, lon_deg=lon_deg))

    def plant(self, tree: ControlTree) -> FleetPlant:
        """Return it for the plan; `tree` is its own."""
        grid, rating_kw = self.file.scenario.grid, tree.inverters_kw("")
        limit_kw = min(self.entry.export_limit_kw or rating_kw, grid.pmax * rating_kw)
        return FleetPlant(
            name=self.entry.name, export_limit_kw=limit_kw, grid=replace(grid, pmin=0.0, pmax=1.0)
        )

    def storages(self) -> Iterator[StorageSettings]:
        for one in self.file.scenario.storage:
            yield replace(one, cluster=self.path(one.cluster))

    def settings(self) -> Iterator[InverterSettings]:
        """Yield how its inverters follow commands."""
        plant = self.file.scenario.plant
        of_all = InverterSettings(
            revert=plant.revert, ramp_percent_per_s=plant.ramp_percent_per_s, delay_s=plant.delay_s
        )
        for one in (of_all, *plant.settings):
            yield replace(one, nodes=self.path(one.nodes))

    def path(self, node: str) -> str:
        """Return the path in the fleet of a node of the plant."""
        return f"{self.entry.name}/{node}" if node else self.entry.name


def members(scenario_file: ScenarioFile) -> list[Member]:
    """Read the scenarios of a fleet's plants, and check that they fit together."""
    fleet = scenario_file.scenario
    own_alone = {
        "plant.inverters, plant.grid": fleet.plant.inverters or fleet.plant.grid,
        "plant.rating_kw": fleet.plant.rating_kw,
        "irradiance": fleet.irradiance != CloudIrradiance(),
        "pv": fleet.pv != PvSettings(),
        "control.cluster_sizes, control.cluster_count": fleet.control.cluster_sizes
        or fleet.control.cluster_count,
    }
    for field, is_given in own_alone.items():
        if is_given:
            raise InputError.of(field, "expected none in a fleet: the scenario of a plant has it")
    found: list[Member] = []
    for number, entry in enumerate(fleet.plants):
        with named_plant(number):
            check_name(entry.name, "name")
            if entry.name in {one.entry.name for one in found}:
                raise InputError.of("name", f"expected another name, got {entry.name} again")
            found.append(Member(entry, number, _file_of(scenario_file, entry, number)))
    return found


@contextmanager
def named_plant(number: int) -> Iterator[None]:
    """Name the plant in errors about its entry or its scenario."""
    try:
        yield
    except InputError as error:
        where = f"plants[{number}]"
        if error.field in PlantEntry.__struct_fields__ and not error.place:
            raise error.renamed(f"{where}.{error.field}") from None
        raise InputError.of(f"{where}.scenario", str(error)) from None


def _file_of(fleet_file: ScenarioFile, entry: PlantEntry, number: int) -> ScenarioFile:
    fleet, name = fleet_file.scenario, entry.scenario
    if name.endswith(".toml"):
        name = str(fleet_file.data_path(name))
    file = load_scenario(name, fleet_file.data_folder)
    for field in entry.set:
        if field in _OF_FLEET or not f"{field}.".startswith(tuple(f"{one}." for one in _SET)):
            expected = f"a field of {', '.join(_SET)} without {', '.join(sorted(_OF_FLEET))}"
            raise InputError.of("set", f"expected {expected}, got {field} for {entry.name}")
        if field == "irradiance.seed" and entry.seed is not None:
            raise InputError.of("set", f"expected seed alone, got {field} too for {entry.name}")
    try:
        file = with_settings(file, [*entry.set.items()])
    except InputError as error:
        raise error.renamed("set") from None
    scenario = file.scenario
    for field, is_wrong in (
        ("plants", scenario.plants),
        ("grid.droop", scenario.grid.droop),
        ("grid.pmin", scenario.grid.pmin),
        ("devices", scenario.devices),
        ("plant.available_bias", scenario.plant.available_bias != fleet.plant.available_bias),
    ):
        if is_wrong:
            raise InputError.of("scenario", f"expected {field} in the fleet alone, got {name}")
    if isinstance(scenario.irradiance, CloudIrradiance):
        seed = scenario.irradiance.seed + SEEDS_APART * number
        irradiance = replace(scenario.irradiance, seed=seed if entry.seed is None else entry.seed)
        scenario = replace(scenario, irradiance=irradiance)
    elif entry.seed is not None:
        raise InputError.of("seed", "expected none with measured data")
    zone = ZoneInfo(scenario.time.timezone)
    start = local_start(fleet.time).astimezone(zone).replace(tzinfo=None)
    time = replace(fleet.time, start=start, timezone=scenario.time.timezone)
    return replace(file, scenario=replace(scenario, time=time), source="")
