"""Options that several commands share: the same option has the same name everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from agents.plan import Actuator, Scheme
from bus_schemas.errors import InputError


def _file_in_folder(option: typer.CallbackParam, value: str | None) -> str | None:
    """Refuse a place where no file can be written, before any work is done."""
    if value in (None, "", "-"):
        return value
    path = Path(str(value))
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"{option.opts[0]}: expected a file in an existing folder, got {path}")
    return value


RunArgument: TypeAlias = Annotated[
    Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
]
ScenarioArgument: TypeAlias = Annotated[
    str, typer.Argument(help="A shipped scenario (see `heliarch scenarios`) or a TOML file.")
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
PaceOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Simulated seconds per second: 1 is real time, max is lockstep.", metavar="PACE"
    ),
]
SeedOption: TypeAlias = Annotated[int | None, typer.Option(help="Seed of the synthetic clouds.")]
SchemeOption: TypeAlias = Annotated[
    Scheme | None, typer.Option(help="How maximum powers are estimated.")
]
ActuatorOption: TypeAlias = Annotated[
    Actuator | None, typer.Option(help="A command is a fraction of the maximum, or a limit.")
]
SettingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change a field of the scenario: commitment.share=0.5. May be given several times.",
        metavar="FIELD=VALUE",
    ),
]
FaultOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        # In a terminal of 80 columns, longer words than these would be cut.
        help="Make links imperfect: source=c1/*,delay=50ms,loss=2% (fields: source, listener, "
        "signal, delay, jitter, distribution, loss, duplicate, reorder, reorder-by, "
        "silent=60s..90s). May be given several times.",
        metavar="RULE",
    ),
]
ExternalOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--external",
        help="Do not start this agent; wait for a device of your own: c2/inv07, c2, central or "
        "plant. May be given several times.",
        metavar="AGENT",
    ),
]
ExternalTimeoutOption: TypeAlias = Annotated[
    float,
    typer.Option(
        help="How long to wait for external agents. Once all are there, they have 30 s to answer "
        "the arming rounds.",
        metavar="SECONDS",
    ),
]
BasePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Listen on this port and those after it, with the plant's name as namespace, so "
        "that a device is configured once.",
        metavar="PORT",
    ),
]
CpusOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Run the processes on these processors: 0-1, or plant=0 for one kind (recorder, "
        "plant, central, supervisor, direct). May be given several times.",
        metavar="CPUS",
    ),
]
PriorityOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="In real time: run plant and controllers under SCHED_FIFO with this priority, 1 to "
        "99, if the machine permits it.",
        metavar="PRIORITY",
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
    typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="MOMENT"),
]
LastOption: TypeAlias = Annotated[
    str | None, typer.Option("--to", help="Last cycle, in the same forms.", metavar="MOMENT")
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

PageOption: TypeAlias = Annotated[
    bool, typer.Option("--page", help="Show the run in a browser, while it goes on.")
]
PagePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        min=0, max=65535, help="Port of the page; default: any that is free.", metavar="PORT"
    ),
]
PageAddressOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Address of the page; default 127.0.0.1, for this machine alone. Other hosts reach "
        "0.0.0.0, with the token that is printed.",
        metavar="ADDRESS",
    ),
]

# What comes out of it ----------------------------------------------------------------------------

OutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the run; default runs/NAME-TIME.", metavar="DIR"),
]
ReportOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--report",
        help="Write an HTML page to FILE.html, or to a default path, which is printed.",
        metavar="[FILE]",
        callback=_file_in_folder,
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
        callback=_file_in_folder,
    ),
]
