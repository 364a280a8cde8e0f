"""Options that several commands share: the same option has the same name and text everywhere."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, get_type_hints

from cyclopts import Group, Parameter, Token
from cyclopts.validators import Number

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError, not_one_of
from scenarios.run_options import RunOptions, check_options

if TYPE_CHECKING:
    from scenarios.scenario import ScenarioFile

OPTIONS: Final = Group.create_ordered("Options")
PLANT: Final = Group.create_ordered("Plant")
TIME: Final = Group.create_ordered("Time")
FAULTS: Final = Group.create_ordered("Faults")
DEVICES: Final = Group.create_ordered("Your own devices")
HOSTS: Final = Group.create_ordered("Other hosts and security")
MACHINE: Final = Group.create_ordered("Processors")
PAGE: Final = Group.create_ordered("Page")
FILES: Final = Group.create_ordered("Files")
"""The panels of `--help`, in their order."""


def new_file(kind: object, value: str | None) -> None:
    """Refuse a path at which no result can be written, before any work is done."""
    if not value or value == "-":
        return
    if value.startswith("-"):  # The next option.
        raise ValueError("Expected a file.")
    path = Path(value)
    # `--json plant.toml`, as if `--json` were a switch, must not replace the scenario.
    is_input = path.suffix in {".toml", ".mcap"}
    place = path if path.exists() else path.absolute().parent
    if is_input or path.is_dir() or not os.access(place, os.W_OK):
        raise ValueError("Expected a file for the result that can be written.")


def new_table(kind: object, value: str | None) -> None:
    if value == "-":
        raise ValueError("Expected a file.")
    new_file(kind, value)


def _new_page(kind: object, value: str | None) -> None:
    if value and not value.endswith(".html"):
        raise ValueError("Expected a file whose name ends in .html.")
    new_file(kind, value)


# Arguments and single options ---------------------------------------------------------------------


def _option(name: str, metavar: str | None, group: Group, text: str, **more: Any) -> Parameter:
    return Parameter(name, metavar=metavar, group=group, help=text, **more)


def _whole_number(kind: object, tokens: Sequence[Token]) -> int:
    """Read a whole number; by itself, cyclopts would round others."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"expected a whole number, got {tokens[0].value}") from None


_Text = str | None
_Texts = list[str] | None
Whole = Annotated[int, Parameter(converter=_whole_number)]

Run = Annotated[Path, Parameter(help="Folder of a run, or its run.mcap.")]
Scenario = Annotated[
    str, Parameter(help="A shipped scenario (see `heliarch scenarios`) or a TOML file.")
]
_SET = "Change a field of the scenario: commitment.share=0.5. May be given several times."
Settings = Annotated[_Texts, _option("--set", "FIELD=VALUE", PLANT, _SET)]
Seed = Annotated[Whole | None, _option("--seed", None, PLANT, "Seed of the synthetic clouds.")]
_DATA = "Folder of the data files that the scenario names."
Data = Annotated[Path | None, _option("--data", "DIR", FILES, _DATA)]
_JSON = "Write the result as JSON; - is standard output."
_AS_FILE: Final = {"allow_leading_hyphen": True, "validator": new_file}
Json = Annotated[_Text, _option("--json", "FILE", FILES, _JSON, **_AS_FILE)]
_REPORT = (
    "Write an HTML page to a file whose name ends in .html, or to a default path, which is printed."
)
Report = Annotated[_Text, _option("--report", "[FILE.html]", FILES, _REPORT, validator=_new_page)]
"""None is no page, an empty text the default file."""

_WORKERS = "Processes that share the work."
_SOME: Final = Number(gte=1, lte=256)
Workers = Annotated[Whole, _option("--workers", None, OPTIONS, _WORKERS, validator=_SOME)]
_FROM = "First cycle: 13:49:00, 90s, or its number."
Start = Annotated[_Text, _option("--from", "TIME", OPTIONS, _FROM)]
_TO = "The cycle before which to end, in the same forms."
End = Annotated[_Text, _option("--to", "TIME", OPTIONS, _TO)]
_NODES = "Only these nodes: `c2/inv07,c1/*,central` (`c1/*`: c1 and all below it; `*`: all)."
Nodes = Annotated[_Text, _option("--nodes", "NODES", OPTIONS, _NODES)]
_SIGNALS = "Only these signals, separated by commas: impp,residual."
Signals = Annotated[_Text, _option("--signals", "NAMES", OPTIONS, _SIGNALS)]
_TOLERANCE = "Largest difference between numbers that count as equal."
Tolerance = Annotated[
    float, _option("--tolerance", "X", OPTIONS, _TOLERANCE, validator=Number(gte=0))
]
Port = Annotated[Whole, Parameter(metavar="PORT", validator=Number(gte=0, lte=65535))]
_PAGE_PORT = "Port of the page; default: any that is free."
PagePort = Annotated[Port | None, _option("--page-port", "PORT", PAGE, _PAGE_PORT)]
_PAGE_ADDRESS = (
    "Address of the page; default 127.0.0.1, for this machine only. 0.0.0.0 is for other hosts "
    "too, which need the token that is printed."
)
PageAddress = Annotated[_Text, _option("--page-address", "ADDRESS", PAGE, _PAGE_ADDRESS)]
_Time = Annotated[_Text, Parameter(metavar="TIME")]

# Groups of options, for commands that run a plant -------------------------------------------------


@Parameter("*", group=TIME)
@dataclass(frozen=True)
class TimeOptions:
    """Which part of a scenario is run.

    Parameters
    ----------
    start
        Local time of the first cycle: 12:30, or 2010-04-01T12:30.
    duration
        Simulated time, in place of --to: seconds, or 90s, 15m, 1h30m.
    end
        Local time at which the last cycle ends.
    """

    start: Annotated[_Time, Parameter("--from")] = None
    duration: _Time = None
    end: Annotated[_Time, Parameter("--to")] = None


@Parameter("*", group=TIME)
@dataclass(frozen=True)
class SpanOptions(TimeOptions):
    """Which part of a scenario is run, and how fast.

    Parameters
    ----------
    pace
        Simulated seconds per second: 1 is real time, max is lockstep.
    """

    pace: Annotated[str | None, Parameter(metavar="PACE")] = None


@Parameter("*", group=PLANT)
@dataclass(frozen=True)
class PlantOptions:
    """What is different from the scenario.

    Parameters
    ----------
    scheme
        How maximum powers are estimated.
    actuator
        Whether a command is a fraction of the maximum or a power limit.
    faults
        Make links imperfect: `source=c1/*,delay=50ms` (fields: source, listener, signal, delay,
        jitter, distribution, loss, duplicate, reorder, reorder-by, at=60s..90s). Or cut links,
        freeze or kill controllers: `source=c1,blackout=5s..9s`, `partition=c1|c2,at=5s..9s`,
        `freeze=c2,at=5s..9s`, `kill=c2,at=5s`, `trip=c2/inv07,at=5s..9s`. May be given several
        times.
    """

    seed: Seed = None
    scheme: Scheme | None = None
    actuator: Actuator | None = None
    faults: Annotated[list[str] | None, Parameter("--fault", metavar="RULE", group=FAULTS)] = None


@Parameter("*")
@dataclass(frozen=True)
class ProcessOptions:
    """External agents, real inverters, keys, and how the processes use the machine.

    Parameters
    ----------
    external
        Do not start this agent; wait for your own device: c2/inv07, c2, central or plant. May be
        given several times.
    devices
        Use a real inverter, over Modbus TCP: NODE=modbus://10.0.0.7/1. With one for each inverter,
        meter=ADDRESS is the plant's real meter. May be given several times.
    external_timeout_s
        How long to wait for external agents and other hosts. Once all are there, they have 30 s
        to answer the arming rounds.
    base_port
        Listen on this port and those after it, with the plant's name as namespace, so that a
        device is configured once.
    secure
        Encrypt every link, and admit agents only by the certificates of `heliarch keys`.
    keys
        Folder of the keys; default keys/PLANT.
    address
        Address at which the agents listen, for devices and controllers on other hosts; needs
        --secure.
    on
        Leave these controllers to `heliarch node` on the host with this address:
        `10.0.0.2=c2/*,c3/inv12`. May be given several times.
    cpus
        Run the processes on these processors: 0-1, or plant=0 for one kind (recorder, plant,
        central, supervisor, direct). May be given several times.
    priority
        In real time: run plant and controllers under SCHED_FIFO with this priority, 1 to 99, if
        the machine permits it.
    """

    external: Annotated[list[str] | None, Parameter(metavar="AGENT", group=DEVICES)] = None
    devices: Annotated[
        list[str] | None, Parameter("--device", metavar="NODE=ADDRESS", group=DEVICES)
    ] = None
    external_timeout_s: Annotated[
        float, Parameter("--external-timeout", metavar="SECONDS", group=DEVICES)
    ] = 60.0
    base_port: Annotated[Whole | None, Parameter(metavar="PORT", group=DEVICES)] = None
    secure: Annotated[bool | None, Parameter(group=HOSTS)] = None
    keys: Annotated[Path | None, Parameter(metavar="DIR", group=HOSTS)] = None
    address: Annotated[str, Parameter(metavar="ADDRESS", group=HOSTS)] = "127.0.0.1"
    on: Annotated[list[str] | None, Parameter(metavar="ADDRESS=AGENTS", group=HOSTS)] = None
    cpus: Annotated[list[str] | None, Parameter(metavar="CPUS", group=MACHINE)] = None
    priority: Annotated[Whole | None, Parameter(group=MACHINE)] = None


@Parameter("*", group=PAGE)
@dataclass(frozen=True)
class PageOptions:
    """The page that shows a run.

    Parameters
    ----------
    page
        Show the run in a browser while it runs.
    """

    page: bool = False
    page_port: PagePort = None
    page_address: PageAddress = None


@Parameter("*", group=FILES)
@dataclass(frozen=True)
class ResultOptions:
    """Where data come from and results go."""

    data: Data = None
    report: Report = None
    json: Json = None


@Parameter("*", group=FILES)
@dataclass(frozen=True)
class FileOptions(ResultOptions):
    """The same, and the folder of a run.

    Parameters
    ----------
    out
        Folder of the run; default runs/NAME-TIME.
    """

    out: Annotated[Path | None, Parameter(metavar="DIR")] = None


def run_options(*groups: object, **more: Any) -> RunOptions:
    """Return what groups of options ask for, beside a scenario, of a run, and check it."""
    fields: dict[str, Any] = {}
    for group in groups:
        fields |= vars(group)
    options = RunOptions(**fields, **more)
    check_options(options)
    return options


def refuse_given(why: str, options: Mapping[str, object], *groups: object) -> None:
    """Refuse options, by name, and options in groups, that are not as they are by default."""
    given = [name for name, value in options.items() if value is not None and value is not False]
    for group in groups:
        kinds = get_type_hints(type(group), include_extras=True)
        for field, value in vars(group).items():
            if value != getattr(type(group), field):
                names = [one.name for one in getattr(kinds[field], "__metadata__", ()) if one.name]
                given.append(names[-1][0] if names else f"--{field.replace('_', '-')}")
    for name in given:
        raise InputError(f"{name}: {why}")


def is_run(path: Path) -> bool:
    """Whether a path names a run rather than a scenario. The run need not exist."""
    from scenarios.scenario import shipped_scenarios

    is_elsewhere = len(path.parts) > 1 and path.suffix != ".toml"
    if is_elsewhere or path.suffix == ".mcap" or (path / "run.mcap").exists():
        return True
    if path.suffix != ".toml" and str(path) not in shipped_scenarios():
        others = "a run, a scenario *.toml, or one of "
        raise InputError(f"{path}: {not_one_of(shipped_scenarios(), str(path), others)}")
    return False


def changed_scenario(
    scenario: str, data: Path | None, settings: Sequence[str] | None
) -> ScenarioFile:
    """Load a scenario, and change the fields that `--set` names."""
    from scenarios.scenario import load_scenario
    from scenarios.settings import with_single_settings

    return with_single_settings(load_scenario(scenario, data), settings or ())
