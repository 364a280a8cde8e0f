"""Scenario files: what a run is about, in TOML, checked field by field before anything starts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias
from zoneinfo import ZoneInfo, available_timezones

import msgspec
from msgspec import Meta

from agents.cycle import KINDS, STAGES
from agents.faults import Fault
from agents.plan_parts import PlannedOrder
from agents.settings import (
    Actuator,
    Delay,
    GridSettings,
    InverterSettings,
    Ramp,
    RestartPolicy,
    Revert,
    Scheme,
    StorageHelp,
    StorageSettings,
)
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import InputError, not_one_of
from bus_schemas.signals import SIGNALS
from bus_schemas.tree import check_name
from scenarios.elsewhere import DeviceTable
from scenarios.fields import checked, line_of
from scenarios.real_time import FASTEST_PACE, SLOWEST_PACE, Processes
from scenarios.run_options import LARGEST_SEED
from scenarios.times import LONGEST_S, SHORTEST_CYCLE_S, on_day
from sim_plant.clouds import CloudSettings
from sim_plant.commitment import CommitmentSettings
from sim_plant.frequency import FrequencySettings
from sim_plant.irradiance import StatedForm
from sim_plant.pv import PvSettings
from sim_plant.regulation import RegulationSettings
from sim_plant.sites import Grid


def _one_of(names: Iterable[str]) -> Meta:
    """Return what a text must be: one of these names."""
    return Meta(pattern="|".join(f"^{name}$" for name in names))


Seed: TypeAlias = Annotated[int, Meta(ge=0, le=LARGEST_SEED)]
Positive: TypeAlias = Annotated[int, Meta(ge=1, le=10**6)]
NotNegative: TypeAlias = Annotated[int, Meta(ge=0)]
Limit: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e12)]
Amount: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12)]
Tier: TypeAlias = Annotated[str, _one_of(STAGES)]
AnyKind: TypeAlias = Annotated[str, _one_of(KINDS)]
HopSignal: TypeAlias = Annotated[
    str, _one_of(row.name for row in SIGNALS if row.hop_p99_ms is not None)
]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scenario file: a field that it does not know is an error."""


def check_timezone(name: str, where: str = "timezone") -> None:
    if name not in available_timezones():
        expected = "an IANA name such as Pacific/Honolulu"
        raise InputError.of(where, f"expected {expected}, got {name!r}")


class TimeTable(_Table, frozen=True):
    """When the run takes place.

    start: Local time of the first cycle.
    timezone: IANA name, such as `Pacific/Honolulu`.
    duration_s: Length of the run [s].
    cycle_s: Length of one cycle [s].
    """

    start: datetime
    timezone: str
    duration_s: Annotated[float, Meta(gt=0.0, le=LONGEST_S)]
    cycle_s: Annotated[float, Meta(ge=SHORTEST_CYCLE_S, le=3600.0)] = 1.0

    def __post_init__(self) -> None:
        check_timezone(self.timezone)


class PlantTable(_Table, frozen=True):
    """The inverters.

    inverters: CSV: `inverter, lat, lon[, rating_kw]`.
    rating_kw: AC rating of the plant, split equally where the CSV has no ratings.
    altitude_m: Height above the sea [m].
    block_m: Side of the square of modules behind an inverter; synthetic clouds are averaged over
        it [m].
    actuator: A command is a power `limit`, or a `fraction` of the inverter's maximum.
    meter_noise: Standard deviation of a meter's error, as a share of the reading.
    available_bias: Relative error of `available_kw`. Default: none is stated.
    available_share: Share of the inverters that state it, evenly among them.
    ramp_percent_per_s: Largest change of power, in % of the rating per second.
    delay_s: Time until a command takes effect [s].
    meter_seed: Seed of the meter noise.
    ramp_limit_percent_per_min: Ramp limit in % of the rating per minute: judged, not enforced.
    """

    inverters: str | None = None
    grid: Grid | None = None
    rating_kw: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    altitude_m: Annotated[float, Meta(ge=-500.0, le=9000.0)] = 0.0
    block_m: Annotated[float, Meta(ge=0.0, le=2000.0)] = 0.0
    actuator: Actuator = "limit"
    meter_noise: Annotated[float, Meta(ge=0.0, le=0.05)] = 0.0
    available_bias: Annotated[float, Meta(ge=-0.5, le=0.5)] | None = None
    available_share: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0
    revert: Revert = Revert()
    ramp_percent_per_s: Ramp | None = None
    delay_s: Delay = 0.0
    settings: tuple[InverterSettings, ...] = ()
    meter_seed: Seed = 0
    ramp_limit_percent_per_min: Annotated[float, Meta(gt=0.0, le=6000.0)] | None = None


class CloudIrradiance(_Table, frozen=True, tag="clouds", tag_field="kind"):
    """Synthetic irradiance: a cloud field that drifts over the plant.

    seed: Seed of the cloud field; `--seed` replaces it.
    clear_until: Local time up to which the sky is clear. Default: never clear.
    """

    seed: Seed = 0
    clouds: CloudSettings = CloudSettings()
    clear_until: datetime | None = None


class MeasuredIrradiance(_Table, StatedForm, frozen=True, tag="measured", tag_field="kind"):
    """Measured irradiance: a file of GHI with one column for each station, and their positions.

    ghi: CSV: time stamps, then a column of GHI [W/m^2] for each station.
    positions: CSV with the columns `station, lat, lon`.
    stations: Stations to use. Default: all listed ones.
    max_gap_s: Longest gap that is filled on a straight line [s]. Default: none.
    """

    ghi: str
    positions: str
    stations: tuple[str, ...] | None = None
    max_gap_s: Annotated[float, Meta(gt=0.0, le=LONGEST_S)] | None = None

    def __post_init__(self) -> None:
        if self.timezone is not None:
            check_timezone(self.timezone)


class OahuGridIrradiance(_Table, frozen=True, tag="oahu-grid", tag_field="kind"):
    """Measured irradiance: daily files of the NREL Oahu Solar Measurement Grid, as published.

    positions: CSV with the columns `station, lat, lon`.
    folder: Folder of YYYYMMDD.txt. Default: `--data`.
    stations: Default: all 17 horizontal sensors.
    most_missing: A sensor that misses a larger share of its day is left out; gaps of the others are
        filled from their neighbours.
    """

    positions: str
    folder: str | None = None
    stations: tuple[str, ...] | None = None
    most_missing: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.1


class DcCurrents(_Table, frozen=True, tag="dc-current", tag_field="kind"):
    """Power from the measured DC currents of a real plant's combiners, without irradiance.

    currents: CSV: `t_s` (0 at `time.start`), then a column for each combiner.
    positions: CSV with the columns `combiner, inverter, x_m, y_m`.
    full_power_current: Current of an inverter at its rating, as in the file.
    lat: Latitude of the plant's middle. Default: unknown.
    lon: Longitude of the plant's middle. Default: unknown.
    """

    currents: str
    positions: str
    full_power_current: Annotated[float, Meta(gt=0.0, le=1e9)] = 100.0
    lat: Annotated[float, Meta(ge=-80.0, le=80.0)] | None = None
    lon: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None

    def __post_init__(self) -> None:
        if (self.lat is None) != (self.lon is None):
            raise InputError.of("lat", f"expected lon with it, got {self.lat} and {self.lon}")

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude of the plant's middle; None: one of them is unknown."""
        return None if self.lat is None or self.lon is None else (self.lat, self.lon)


Irradiance: TypeAlias = CloudIrradiance | MeasuredIrradiance | OahuGridIrradiance | DcCurrents


class ControlTable(_Table, frozen=True):
    """The control tree and the rules of its controllers.

    cluster_sizes: Sizes of the clusters of each tier, the lowest first.
    cluster_count: Number of clusters of each tier, instead of sizes.
    scheme: How an inverter's maximum power is estimated.
    clusters: How members are chosen.
    clusters_seed: Seed of `random` clusters.
    period_cycles: Cycles between turns of each tier, the central controller's first, each a
        multiple of the next.
    alpha_min: Lowest curtailment level.
    hold_cycles: An older input has expired [cycles].
    stall_timeout_s: In lockstep: how long a cycle may stall [s].
    correction: Correct the central target by the plant's meter. Default: by `scheme`.
    offset: The plant aims at so much more than the dispatch, as a share of its rating.
    offset_errors: The same, in mean errors of the plant (over 20 s).
    storage: Storages give what inverters cannot (`last`), or also what these could, until they do
        (`first`).
    """

    cluster_sizes: tuple[tuple[Positive, ...], ...] | None = None
    cluster_count: tuple[Positive, ...] | None = None
    scheme: Scheme = "predictive"
    clusters: Literal["correlation", "geographic", "listed", "random", "most-alike"] = "correlation"
    clusters_seed: Seed = 0
    period_cycles: tuple[Positive, ...] | None = None
    alpha_min: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.05
    hold_cycles: NotNegative = 10
    stall_timeout_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 3.0
    correction: bool | None = None
    offset: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0
    offset_errors: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.0
    storage: StorageHelp = "last"


class NeighboursTable(_Table, frozen=True):
    """Where the correlation between inverters comes from.

    history: An earlier day, as a plant knows it, or the run's own irradiance.
    """

    history: Literal["earlier-day", "hindsight"]


class PlantEntry(_Table, frozen=True):
    """A plant of a fleet.

    name: Its name in the control tree.
    scenario: A shipped scenario, or a TOML file.
    lat: Latitude of its middle. Default: its scenario's.
    lon: Longitude of its middle.
    seed: Seed of its sky. Default: its scenario's, and 1000 more for each plant before it.
    export_limit_kw: Most that it may feed in at its meter [kW]. Default: its rating.
    set: Other fields of its scenario, by name.
    """

    name: str
    scenario: str
    lat: Annotated[float, Meta(ge=-80.0, le=80.0)] | None = None
    lon: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    seed: Seed | None = None
    export_limit_kw: Limit | None = None
    set: dict[str, bool | int | float | str] = {}

    def __post_init__(self) -> None:
        if (self.lat is None) != (self.lon is None):
            raise InputError.of("lat", f"expected lon with it, got {self.lat} and {self.lon}")


class BudgetTable(_Table, frozen=True):
    """Upper limits by which a run in real time is judged.

    loop_p99_ms: From the plant's tick to its last command. Default: half the cycle.
    decision_p99_ms: By tier. Default: each stage's slice, and the paper's upper bounds.
    hop_p99_ms: By signal. Default: 10.
    late_cycles_percent: Cycles in which one of our agents missed a deadline, overran or published
        nothing.
    lost_messages: In the whole run.
    cpu_percent: Of a core, per process, by kind. Default: 80.
    """

    loop_p99_ms: Limit | None = None
    decision_p99_ms: dict[Tier, Limit] = {}
    hop_p99_ms: dict[HopSignal, Limit] = {}
    late_cycles_percent: Amount = 1.0
    lost_messages: NotNegative = 0
    cpu_percent: dict[AnyKind, Amount] = {}


class AnswerBudgets(_Table, frozen=True):
    """Limits by which the plant's answers to orders are judged: the run fails if one is not kept.

    reaction_s: Of a step: time until a tenth of it is covered [s].
    rise_s: Of a step: time from a tenth to nine tenths [s].
    settling_of_change_s: Of a step: time until the power stays within 2.5 % of it, or 0.5 % of the
        rating if that is more [s].
    damping: Of a step: least damping ratio, from its overshoot.
    settling_s: Time until the power stays within 1 % of the rating [s].
    overshoot_percent: Largest power beyond the order, in % of the rating.
    error_percent: Mean error at rest, in % of the rating.
    ramp_deviation_percent: Mean deviation from a ramp, in % of the rating.
    score: Least score of an AGC signal.
    response_percent: Least energy of a frequency response, in % of the droop's.
    """

    reaction_s: Limit | None = None
    rise_s: Limit | None = None
    settling_of_change_s: Limit | None = None
    damping: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    settling_s: Limit | None = None
    overshoot_percent: Amount | None = None
    error_percent: Amount | None = None
    ramp_deviation_percent: Amount | None = None
    score: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    response_percent: Annotated[float, Meta(ge=0.0, le=100.0)] | None = None


class TimingTable(_Table, frozen=True):
    """What a run in real time is judged by."""

    budgets: BudgetTable = BudgetTable()


class Scenario(_Table, frozen=True):
    """A run, as its file describes it.

    name: First part of every key on the bus.
    title: Heading of tables and reports.
    pace: Simulated seconds per second: 1 is real time, `max` lockstep.
    faults_seed: Seed of what is drawn for faults.
    processes: Which agents share a process.
    """

    name: str
    title: str
    time: TimeTable
    plant: PlantTable
    irradiance: Irradiance
    control: ControlTable
    neighbours: NeighboursTable
    commitment: CommitmentSettings
    storage: tuple[StorageSettings, ...] = ()
    plants: tuple[PlantEntry, ...] = ()
    regulation: RegulationSettings | None = None
    grid: GridSettings = GridSettings()
    frequency: FrequencySettings | None = None
    pv: PvSettings = PvSettings()
    pace: Annotated[float, Meta(ge=SLOWEST_PACE, le=FASTEST_PACE)] | Literal["max"] = "max"
    faults: tuple[Fault, ...] = ()
    faults_seed: Seed = 0
    restart: RestartPolicy = RestartPolicy()
    devices: tuple[DeviceTable, ...] = ()
    processes: Processes = "agent"
    timing: TimingTable = TimingTable()
    orders: tuple[PlannedOrder, ...] = ()
    answers: AnswerBudgets | None = None

    def __post_init__(self) -> None:
        check_name(self.name, "name")


class ScenarioFile(msgspec.Struct, frozen=True):
    """A scenario, its text, and the folder that its relative paths start from.

    `source` is the file as it was read, for the lines in errors; empty once settings changed it.
    """

    scenario: Scenario
    text: str
    path: Path
    data_folder: Path
    source: str = ""

    def __repr__(self) -> str:
        return f"<ScenarioFile {self.scenario.name}: {self.scenario.title}>"

    @property
    def needs_data(self) -> bool:
        """Whether it runs on measured data, which does not come with Heliarch."""
        return not isinstance(self.scenario.irradiance, CloudIrradiance)

    @contextmanager
    def named(self) -> Iterator[None]:
        """Name the file, and the line, in errors about its fields."""
        try:
            yield
        except InputError as error:
            found = error.within(line_of(error.field, self.source))
            raise found.within(str(self.path)) from None

    def data_path(self, name: str) -> Path:
        """Path of a file or folder that the scenario names.

        It is looked for beside the shipped scenarios too, for changed copies of those.
        """
        for folder in (self.path.parent, self.data_folder, _SHIPPED):
            if (folder / name).exists():
                return folder / name
        where = "docs/data.md says where its data come from"
        raise InputError(
            f"{name}: expected it beside the scenario, in the folder of --data, or beside the "
            f"shipped scenarios, got none{f'; {where}' if self.path.parent == _SHIPPED else ''}"
        )


_OF_FLEET: Final[dict[str, object]] = {
    "plant": {},
    "irradiance": {"kind": "clouds"},
    "control": {},
    "neighbours": {"history": "earlier-day"},
}
"""Tables that each plant of a fleet has in its own scenario."""

_SHIPPED: Final = Path(str(files("scenarios"))) / "shipped"


def shipped_scenarios() -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.toml")))


def load_scenario(name_or_path: str, data_folder: Path | None = None) -> ScenarioFile:
    """Read a shipped scenario or a TOML file, and check it.

    Data files that are not beside the scenario are looked for in `data_folder`.
    """
    if data_folder is not None and not data_folder.is_dir():
        raise InputError.of("--data", f"expected a folder with data files, got {data_folder}")
    path = _find(name_or_path)
    try:
        # An editor may have put a byte order mark first.
        text = path.read_text(encoding="utf-8-sig")
        document = msgspec.toml.decode(text)
    except UNREADABLE as error:
        raise InputError(f"{path}: expected TOML in UTF-8: {error}") from None
    if document.get("plants"):
        document = _OF_FLEET | document
    scenario = checked(document, Scenario, str(path), text)
    return ScenarioFile(scenario, text, path, data_folder or path.parent, source=text)


def local_start(time: TimeTable) -> datetime:
    return zoned(time.start, time, "time.start")


def zoned(moment: datetime, time: TimeTable, where: str) -> datetime:
    """Return a time in the zone of a scenario; the first one where the clocks repeat it."""
    return on_day(moment, datetime(1970, 1, 1, tzinfo=ZoneInfo(time.timezone)), where)[0]


def _find(name_or_path: str) -> Path:
    path = Path(name_or_path)
    if path.suffix == ".toml":
        if not path.is_file():
            raise InputError(f"{path}: expected a scenario file, got no such file")
        return path
    if name_or_path not in shipped_scenarios():
        known = not_one_of(shipped_scenarios(), name_or_path, "the path of a .toml file, or ")
        raise InputError.of("scenario", known)
    return _SHIPPED / f"{name_or_path}.toml"
