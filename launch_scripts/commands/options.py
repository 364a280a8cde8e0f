"""Options that several commands share: the same option has the same name everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from agents.plan import Actuator, Scheme

ScenarioArgument: TypeAlias = Annotated[
    str, typer.Argument(help="A shipped scenario (see `heliarch scenarios`) or a TOML file.")
]
StartOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Local time of the first cycle: 12:30, or 2010-04-01T12:30.", metavar="TIME"),
]
DurationOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Simulated time: seconds, or 90s, 15m, 1h30m.", metavar="TIME"),
]
PaceOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Simulated seconds per second (1 is real time), or max: lockstep.", metavar="PACE"
    ),
]
SeedOption: TypeAlias = Annotated[int | None, typer.Option(help="Seed of the synthetic clouds.")]
SchemeOption: TypeAlias = Annotated[
    Scheme | None, typer.Option(help="How maxima are estimated: as the scenario says, or this.")
]
ActuatorOption: TypeAlias = Annotated[
    Actuator | None, typer.Option(help="What inverters do with a command: fraction or limit.")
]
FaultOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        # Words of more letters than these are cut in a terminal of 80 columns.
        help="Make links imperfect: source=c1/*,delay=50ms,loss=2% (words: source, listener, "
        "signal, delay, jitter, distribution, loss, duplicate, reorder, reorder-by, "
        "silent=60s..90s). May be given several times.",
        metavar="RULE",
    ),
]
ExternalOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--external",
        help="Leave this agent out and wait for a device of your own: c2/inv07, c2, central or "
        "plant. May be given several times.",
        metavar="AGENT",
    ),
]
ExternalTimeoutOption: TypeAlias = Annotated[
    float,
    typer.Option(
        help="Seconds to wait for external agents to appear. Once all are there, they have 30 s to "
        "answer the arming rounds.",
        metavar="SECONDS",
    ),
]
BasePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Listen on this port and those after it, under the plant's name as namespace, so "
        "that a device is set up once.",
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
        "99, where the machine permits it.",
        metavar="PRIORITY",
    ),
]
OutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the run; default runs/NAME-TIME.", metavar="DIR"),
]
DataOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the data files that the scenario names.", metavar="DIR"),
]
ReportFlag: TypeAlias = Annotated[
    bool, typer.Option("--report", help="Write an HTML report into the run's folder.")
]
JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--json", help="Write the summary as JSON; - is stdout.", metavar="PATH"),
]
