"""Options that several commands share: the same option has the same name everywhere."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from agents.plan import Actuator, Scheme
from bus_schemas.errors import InputError

if TYPE_CHECKING:
    from launch_scripts.scenarios.scenario import ScenarioFile


def file_in_folder(option: typer.CallbackParam, value: str | None) -> str | None:
    """Refuse a place where no file can be written, before any work is done."""
    if value in (None, "", "-"):
        return value
    path = Path(str(value))
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"{option.opts[0]}: expected a file in an existing folder, got {path}")
    return value


RunArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(help="Folder of a run, or its run.mcap.", metavar="RUN", show_default=False),
]
ScenarioArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A shipped scenario (see `heliarch scenarios`) or a TOML file.", metavar="SCENARIO"
    ),
]

# What is run -------------------------------------------------------------------------------------

StartOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--from",
        help="Local time of the first cycle: 12:30, or 2010-04-01T12:30.",
        metavar="TIME",
    ),
]
EndOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--to", help="Local time at which the last cycle ends.", metavar="TIME"),
]
DurationOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Simulated time, in place of --to: seconds, or 90s, 15m, 1h30m.", metavar="TIME"
    ),
]
SeedOption: TypeAlias = Annotated[int | None, typer.Option(help="Seed of the synthetic clouds.")]
SchemeOption: TypeAlias = Annotated[
    Scheme | None, typer.Option(help="How maximum powers are estimated.")
]
SettingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change a field of the scenario: commitment.share=0.5. May be given several times.",
        metavar="FIELD=VALUE",
    ),
]
DataOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the data files that the scenario names.", metavar="DIR"),
]
WorkersOption: TypeAlias = Annotated[
    int, typer.Option(min=1, max=256, help="Processes that share the work.")
]

# Which part of a recording -----------------------------------------------------------------------

FirstOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="TIME"),
]
LastOption: TypeAlias = Annotated[
    str | None, typer.Option("--to", help="Last cycle, in the same forms.", metavar="TIME")
]
NodesOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--nodes",
        help="Only these nodes: c2/inv07,c1/*,central (c1/*: c1 and all below it).",
        metavar="NODES",
    ),
]
SignalsOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Only these signals, separated by commas: impp,residual.", metavar="NAMES"),
]

# The page of a run -------------------------------------------------------------------------------

PagePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        min=0, max=65535, help="Port of the page; default: any that is free.", metavar="PORT"
    ),
]
PageAddressOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Address of the page; default 127.0.0.1, for this machine only. 0.0.0.0 is for other "
        "hosts too, with the token that is printed.",
        metavar="ADDRESS",
    ),
]

# What comes out of it ----------------------------------------------------------------------------

ReportOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--report",
        help="Write an HTML page to a file whose name ends in .html, or to a default path, which "
        "is printed.",
        metavar="[FILE.html]",
        callback=file_in_folder,
        show_default=False,
    ),
]
"""None: no page; empty: the default file."""

JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--json",
        help="Write the result as JSON; - is standard output.",
        metavar="FILE",
        callback=file_in_folder,
    ),
]

# Groups, for the commands that run a plant -------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TimeOptions:
    """Which part of a scenario is run."""

    start: StartOption = None
    end: EndOption = None
    duration: DurationOption = None


@dataclass(frozen=True, slots=True)
class SpanOptions(TimeOptions):
    """Which part of a scenario is run, and how fast."""

    pace: Annotated[
        str | None,
        typer.Option(
            help="Simulated seconds per second: 1 is real time, max is lockstep.", metavar="PACE"
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class PlantOptions:
    """What is different from the scenario."""

    seed: SeedOption = None
    scheme: SchemeOption = None
    actuator: Annotated[
        Actuator | None,
        typer.Option(help="Whether a command is a fraction of the maximum or a power limit."),
    ] = None
    settings: SettingsOption = None
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            # In a terminal of 80 columns, longer unbroken text would be cut.
            help="Make links imperfect: source=c1/*,delay=50ms,loss=2% (fields: source, listener, "
            "signal, delay, jitter, distribution, loss, duplicate, reorder, reorder-by, "
            "silent=60s..90s, at=60s..90s). Or cut links, freeze or kill controllers: "
            "partition=c1|c2,at=5s..9s, freeze=c2,at=5s..9s, kill=c2,at=5s. "
            "May be given several times.",
            metavar="RULE",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class ProcessOptions:
    """External agents, real inverters, keys, and how the processes use the machine."""

    external: Annotated[
        list[str] | None,
        typer.Option(
            help="Do not start this agent; wait for your own device: c2/inv07, c2, central or "
            "plant. May be given several times.",
            metavar="AGENT",
        ),
    ] = None
    devices: Annotated[
        list[str] | None,
        typer.Option(
            "--device",
            help="Use a real inverter, over Modbus TCP: c2/inv07=modbus://10.0.0.7/1. May be "
            "given several times.",
            metavar="NODE=ADDRESS",
        ),
    ] = None
    external_timeout_s: Annotated[
        float,
        typer.Option(
            "--external-timeout",
            help="How long to wait for external agents and other hosts. Once all are there, they "
            "have 30 s to answer the arming rounds.",
            metavar="SECONDS",
        ),
    ] = 60.0
    base_port: Annotated[
        int | None,
        typer.Option(
            help="Listen on this port and those after it, with the plant's name as namespace, so "
            "that a device is configured once.",
            metavar="PORT",
        ),
    ] = None
    secure: Annotated[
        bool | None,
        typer.Option(
            "--secure",
            help="Encrypt every link, and admit agents only by the certificates of "
            "`heliarch keys`.",
        ),
    ] = None
    keys: Annotated[
        Path | None,
        typer.Option(help="Folder of the keys; default keys/PLANT.", metavar="DIR"),
    ] = None
    address: Annotated[
        str,
        typer.Option(
            help="Address at which the agents listen, for devices and controllers on other hosts; "
            "needs --secure.",
            metavar="ADDRESS",
        ),
    ] = "127.0.0.1"
    on: Annotated[
        list[str] | None,
        typer.Option(
            help="Leave these controllers to `heliarch node` on the host with this address: "
            "10.0.0.2=c2/*,c3/inv12. May be given several times.",
            metavar="ADDRESS=AGENTS",
        ),
    ] = None
    cpus: Annotated[
        list[str] | None,
        typer.Option(
            help="Run the processes on these processors: 0-1, or plant=0 for one kind (recorder, "
            "plant, central, supervisor, direct). May be given several times.",
            metavar="CPUS",
        ),
    ] = None
    priority: Annotated[
        int | None,
        typer.Option(
            help="In real time: run plant and controllers under SCHED_FIFO with this priority, 1 "
            "to 99, if the machine permits it.",
            metavar="PRIORITY",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class PageOptions:
    """The page that shows a run."""

    page: Annotated[
        bool, typer.Option("--page", help="Show the run in a browser, while it goes on.")
    ] = False
    page_port: PagePortOption = None
    page_address: PageAddressOption = None


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Where data come from and results go."""

    data: DataOption = None
    report: ReportOption = None
    json: JsonOption = None


@dataclass(frozen=True, slots=True)
class FileOptions(ResultOptions):
    """The same of a run, which has a folder."""

    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the run; default runs/NAME-TIME.", metavar="DIR"),
    ] = None


def refuse_others(context: typer.Context, allowed: Collection[str], why: str) -> None:
    """Refuse what the command line has beside the options that are allowed here."""
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if source and source.name == "COMMANDLINE" and name not in allowed:
            raise InputError(f"{option.opts[0]}: {why}")


def changed_scenario(
    scenario: str, data: Path | None, settings: Sequence[str] | None
) -> ScenarioFile:
    """Load a scenario, and change the fields that `--set` names."""
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    return with_settings(load_scenario(scenario, data), settings or ())


def with_groups(command: Callable[..., int | None]) -> Callable[..., int | None]:
    """Return a command that takes each field of its dataclass parameters as an option."""
    taken = inspect.signature(command, eval_str=True).parameters.values()
    groups: dict[str, Any] = {
        taker.name: taker.annotation for taker in taken if is_dataclass(taker.annotation)
    }

    def expanded(**given: Any) -> int | None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        return command(**given)

    options: list[inspect.Parameter] = []
    for taker in taken:
        group = groups.get(taker.name)
        options += inspect.signature(group, eval_str=True).parameters.values() if group else [taker]
    keyword = [option.replace(kind=inspect.Parameter.KEYWORD_ONLY) for option in options]
    expanded.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in keyword}
    expanded.__doc__ = command.__doc__
    return expanded
