"""Scenario files: what a run is about, in TOML, checked field by field before anything starts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias
from zoneinfo import ZoneInfo, available_timezones

import msgspec

from agents.plan import Actuator, Scheme
from bus_schemas.errors import InputError
from bus_schemas.faults import FaultRule
from bus_schemas.tree import check_name
from launch_scripts.scenarios.accepted_words import accepted_fields, accepted_words
from launch_scripts.scenarios.budget_table import TimingTable
from launch_scripts.scenarios.machine_table import MachineTable
from sim_plant.clouds import CloudSettings
from sim_plant.commitment import CommitmentSettings
from sim_plant.pv import PvSettings
from sim_plant.regulation import RegulationSettings

LONGEST_S: Final = 31 * 86400.0
SLOWEST_PACE: Final = 1e-3
FASTEST_PACE: Final = 1e6
LARGEST_SEED: Final = 2**32

Rating: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=1e7)]
Altitude: TypeAlias = Annotated[float, msgspec.Meta(ge=-500.0, le=9000.0)]
Duration: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=LONGEST_S)]
Cycle: TypeAlias = Annotated[float, msgspec.Meta(ge=0.001, le=3600.0)]
Pace: TypeAlias = Annotated[float, msgspec.Meta(ge=SLOWEST_PACE, le=FASTEST_PACE)]
Patience: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=600.0)]
Seed: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_SEED)]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scenario file: a field that it does not know is an error."""


class TimeTable(_Table, frozen=True):
    """When the run takes place.

    Attributes
    ----------
    start
        Local time of the first cycle.
    timezone
        IANA name, for instance `Pacific/Honolulu`.
    duration_s
        Length of the run [s].
    cycle_s
        Length of one cycle [s].
    """

    start: datetime
    timezone: str
    duration_s: Duration
    cycle_s: Cycle = 1.0


class PlantTable(_Table, frozen=True):
    """The inverters.

    Attributes
    ----------
    inverters
        CSV with the columns `inverter, lat, lon` and, if ratings differ, `rating_kw`. Measured
        irradiance needs none: there is one inverter at each station.
    rating_kw
        AC rating of the whole plant, in equal parts, where the CSV gives none.
    altitude_m
        Height above the sea.
    actuator
        What an inverter does with a command: `fraction` (a share of its true maximum, as in the
        paper) or `limit` (an absolute power limit, as real inverters do).
    meter_noise
        Standard deviation of the inverters' power meters, as a share of the power.
    meter_seed
        Seed of that noise.
    available_bias
        Relative error of the available power that the inverters state (SunSpec 122 `WAval`).
        Default: they state none.
    ramp_limit_percent_per_min
        Ramp limit of the grid code, in % of the plant's rating per minute. The run is measured by
        it, not held to it.
    """

    inverters: str | None = None
    rating_kw: Rating | None = None
    altitude_m: Altitude = 0.0
    actuator: Actuator = "fraction"
    meter_noise: Annotated[float, msgspec.Meta(ge=0.0, le=0.05)] = 0.0
    available_bias: Annotated[float, msgspec.Meta(ge=-0.5, le=0.5)] | None = None
    meter_seed: Seed = 0
    ramp_limit_percent_per_min: Annotated[float, msgspec.Meta(gt=0.0, le=6000.0)] | None = None


class CloudIrradiance(_Table, frozen=True, tag="clouds", tag_field="kind"):
    """Synthetic irradiance: a cloud field that drifts over the plant.

    Attributes
    ----------
    seed
        Seed of the cloud field; `--seed` instead.
    clouds
        The sky.
    """

    seed: Seed = 0
    clouds: CloudSettings = CloudSettings()


class MeasuredIrradiance(_Table, frozen=True, tag="measured", tag_field="kind"):
    """Measured irradiance: a CSV of GHI with one column for each station, and their positions.

    Attributes
    ----------
    ghi
        CSV: time stamps in the first column, then GHI [W/m^2], one column for each station.
    positions
        CSV with the columns `station, lat, lon`.
    stations
        Which of them. Default: all.
    """

    ghi: str
    positions: str
    stations: tuple[str, ...] | None = None


class OahuGridIrradiance(_Table, frozen=True, tag="oahu-grid", tag_field="kind"):
    """Measured irradiance: daily files of the NREL Oahu Solar Measurement Grid, as they come.

    Attributes
    ----------
    positions
        CSV with the columns `station, lat, lon`.
    folder
        Where the daily files YYYYMMDD.txt or the archives YYYYMM.zip are. Default: the folder
        given with `--data`.
    stations
        Default: all 17 horizontal sensors.
    gaps
        What becomes of missing values: filled from `neighbours`, or an error (`refuse`).
    most_missing
        A sensor of which a larger share of the day is missing is left out.
    """

    positions: str
    folder: str | None = None
    stations: tuple[str, ...] | None = None
    gaps: Literal["neighbours", "refuse"] = "neighbours"
    most_missing: Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)] = 0.1


class DcCurrents(_Table, frozen=True, tag="dc-current", tag_field="kind"):
    """Power from measured DC currents of a real plant's combiners, without irradiance.

    Attributes
    ----------
    currents
        CSV with the column `t_s`, 0 at `time.start`, and one column for each combiner.
    positions
        CSV with the columns `combiner, inverter, x_m, y_m`.
    full_power_current
        Current at which an inverter is at its rating, in the unit of the file. A convention:
        published currents are normalised by something that is not told.
    gaps
        What becomes of an inverter without any current: left out (`leave-out`), or an error
        (`refuse`, which refuses single missing currents too).
    """

    currents: str
    positions: str
    full_power_current: Annotated[float, msgspec.Meta(gt=0.0, le=1e9)] = 100.0
    gaps: Literal["leave-out", "refuse"] = "leave-out"


Irradiance: TypeAlias = CloudIrradiance | MeasuredIrradiance | OahuGridIrradiance | DcCurrents


class ControlTable(_Table, frozen=True):
    """The control tree and the rules of its controllers.

    Attributes
    ----------
    cluster_sizes
        Sizes of the clusters of each tier, the lowest first: `[[6, 6, 5]]` is three supervisors,
        `[[5, 5, 5, 5], [2, 2]]` puts two more above four.
    cluster_count
        Instead of their sizes, how many clusters each tier has, as equal in size as can be: `[3]`
        makes 6, 6 and 5 of 17 inverters, and 6, 5 and 5 where the data has only 16.
    scheme
        How the maximum of an inverter is estimated: `paper` (that of the last cycle) or
        `predictive` (a forecast of this cycle's, with a margin).
    clusters
        How their members are chosen: `correlation` (least alike, the paper's virtual
        neighbours), `geographic` (nearest) or `listed` (as the inverters are listed). To compare
        with: `random` (by lot) or `most-alike` (the worst).
    clusters_seed
        Seed of that lot.
    period_cycles
        Every how many cycles each tier acts, the central controller's first. Default: each cycle.
    alpha_min
        Lowest curtailment level.
    hold_cycles
        For how many cycles an input holds after it was due. Then it is silent: a child counts as
        zero, and a node without a setpoint falls back to its own share of the dispatch. A longer
        time survives more losses; a controller that is dead is noticed later.
    stall_timeout_s
        How long a stalled cycle is waited for in lockstep [s].
    correction
        Whether the central controller corrects its target by the plant's meter (integral
        correction). Default: with `predictive` yes, with `paper` no.
    deadlines_ms
        In real time: how long after the beginning of a cycle the last word of each tier must be
        out [ms of the wall clock], the central controller's first and the direct controllers' last.
        Default: each stage has the same share of the cycle. In lockstep there are no deadlines.
    """

    cluster_sizes: tuple[tuple[Annotated[int, msgspec.Meta(ge=1)], ...], ...] | None = None
    cluster_count: tuple[Annotated[int, msgspec.Meta(ge=1)], ...] | None = None
    scheme: Scheme = "predictive"
    clusters: Literal["correlation", "geographic", "listed", "random", "most-alike"] = "correlation"
    clusters_seed: Seed = 0
    period_cycles: tuple[int, ...] | None = None
    alpha_min: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.05
    hold_cycles: Annotated[int, msgspec.Meta(ge=0)] = 10
    stall_timeout_s: Patience = 3.0
    correction: bool | None = None
    deadlines_ms: tuple[float, ...] | None = None


class NeighboursTable(_Table, frozen=True):
    """Where the correlation between inverters comes from.

    Attributes
    ----------
    history
        `earlier-day` is the same hours of a synthetic day with another seed: what a plant knows.
        `hindsight` is the run's own irradiance: better than a plant could know, said in the
        summary.
    """

    history: Literal["earlier-day", "hindsight"]


class Scenario(_Table, frozen=True):
    """A run, as its file describes it.

    Attributes
    ----------
    name
        First part of every key on the bus.
    title
        What it is, in words: heads tables and reports.
    time, plant, irradiance, control, neighbours, commitment
        Tables of their own, below.
    regulation
        A table of its own, below. Without it no regulation is offered.
    pv, machine, timing
        Tables of their own, below.
    pace
        Simulated seconds a second; 1 is real time. `max`: in lockstep, as fast as it goes.
        `--pace` instead.
    faults
        Ways in which its network is imperfect; `--fault` adds to them.
    faults_seed
        Seed of what is drawn for them.
    """

    name: str
    title: str
    time: TimeTable
    plant: PlantTable
    irradiance: Irradiance
    control: ControlTable
    neighbours: NeighboursTable
    commitment: CommitmentSettings
    regulation: RegulationSettings | None = None
    pv: PvSettings = PvSettings()
    pace: Pace | Literal["max"] = "max"
    faults: tuple[FaultRule, ...] = ()
    faults_seed: Seed = 0
    machine: MachineTable = MachineTable()
    timing: TimingTable = TimingTable()


class ScenarioFile(msgspec.Struct, frozen=True):
    """A scenario, its text, and the folder that its relative paths start from."""

    scenario: Scenario
    text: str
    path: Path
    data_folder: Path

    def data_path(self, name: str) -> Path:
        """Path of a file that the scenario names.

        It is looked for beside the scenario, in the data folder, and at last beside the shipped
        scenarios, so that a changed copy of one of those still finds its inverters.
        """
        for folder in (self.path.parent, self.data_folder, _SHIPPED):
            if (folder / name).exists():
                return folder / name
        return self.data_folder / name


_SHIPPED: Final = Path(str(files("launch_scripts.scenarios")))


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with Heliarch."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.toml")))


def load_scenario(name_or_path: str, data_folder: Path | None = None) -> ScenarioFile:
    """Read a scenario and check it.

    Parameters
    ----------
    name_or_path
        Name of a shipped scenario, or path of a TOML file.
    data_folder
        Where data files are looked for that are not beside the scenario. Default: the folder of
        the scenario.

    Raises
    ------
    InputError
        There is no such scenario, or it does not say what it must.
    """
    if data_folder is not None and not data_folder.is_dir():
        raise InputError(f"--data {data_folder}: no such folder, accepted is one with data files")
    path = _find(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
        scenario = msgspec.toml.decode(text, type=Scenario)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 at byte {error.start}, accepted is TOML") from None
    except msgspec.ValidationError as error:
        document = msgspec.toml.decode(text)
        raise InputError(f"{path}: {readable(error, document)}") from None
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from None
    check_scenario(scenario, str(path))
    return ScenarioFile(scenario, text, path, data_folder or path.parent)


def check_scenario(scenario: Scenario, where: str) -> None:
    """Check what the types of the fields do not tell.

    Raises
    ------
    InputError
        The name is no part of a key, or the time zone is not known.
    """
    check_name(scenario.name, where)
    if scenario.time.timezone not in available_timezones():
        raise InputError(
            f"{where}: time.timezone is {scenario.time.timezone!r}, accepted is an IANA name "
            "such as Pacific/Honolulu"
        )


def local_start(time: TimeTable) -> datetime:
    """Return the first cycle's time with its zone."""
    zone = ZoneInfo(time.timezone)
    return time.start.astimezone(zone) if time.start.tzinfo else time.start.replace(tzinfo=zone)


def readable(error: msgspec.ValidationError, document: object) -> str:
    """Turn msgspec's `... - at `$.a.b`` around: the field first, and at last what is accepted.

    Parameters
    ----------
    error
        What msgspec has to object to a scenario.
    document
        The scenario, as it was read.
    """
    where, what = place_and_objection(error)
    accepted: tuple[str, ...] = ()
    if "enum value" in what or what.startswith("Invalid value"):
        accepted = accepted_words(Scenario, where)
    elif "unknown field" in what:
        accepted = accepted_fields(Scenario, where, document)
    first = f"{where}: " if where else ""
    return f"{first}{what}" + (f", accepted: {', '.join(accepted)}" if accepted else "")


def place_and_objection(error: msgspec.ValidationError) -> tuple[str, str]:
    """Return where in a scenario an error of msgspec lies, such as `a.b`, and what it is."""
    found = re.fullmatch(r"(.*) - at `\$\.?(.*)`", str(error), re.DOTALL)
    return (found[2], found[1]) if found else ("", str(error))


def _find(name_or_path: str) -> Path:
    path = Path(name_or_path)
    if path.suffix == ".toml":
        if not path.is_file():
            raise InputError(f"{path}: no such scenario file")
        return path
    if name_or_path not in shipped_scenarios():
        raise InputError(
            f"scenario {name_or_path!r} is not known, accepted: "
            f"{', '.join(shipped_scenarios())} or the path of a .toml file"
        )
    return _SHIPPED / f"{name_or_path}.toml"


def with_two_digit_hour(text: str) -> str:
    """Return a time, or date and time, whose hour has two digits as ISO 8601 wants it."""
    return re.sub(r"(^|\d[T ])(?=\d:)", r"\g<1>0", text)


def parse_duration_s(text: str, where: str) -> float:
    """Read a duration: seconds, or numbers with units such as `90s`, `15m`, `1h30m`.

    Raises
    ------
    InputError
        It is not one, or not above zero.
    """
    seconds = sum(_duration_parts(text)) if re.fullmatch(r"(\d+(\.\d+)?[hms]?)+", text) else 0.0
    if not 0.0 < seconds <= LONGEST_S:
        raise InputError(
            f"{where} {text[:40]}: accepted are seconds above 0, or 90s, 15m, 1h30m, "
            f"at most {LONGEST_S / 86400:g} days"
        )
    return seconds


def _duration_parts(text: str) -> Iterator[float]:
    for number, unit in re.findall(r"(\d+(?:\.\d+)?)([hms]?)", text):
        yield float(number) * {"h": 3600.0, "m": 60.0}.get(unit, 1.0)
