"""The command line: `heliarch`."""

# Commands import what they need themselves: `--help` must not wait for pvlib.
# ruff: noqa: PLC0415

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from agents.plan import Actuator, Scheme

_began_at = time.monotonic()

app = typer.Typer(
    name="heliarch",
    help="Run a utility-scale solar plant's controllers as a team of processes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

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
OutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the run; default recordings/runs/NAME-TIME.", metavar="DIR"),
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


@app.command("launch", epilog="Example: heliarch launch oahu --start 12:30 --duration 15m")
def launch_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: ReportFlag = False,
) -> None:
    """Run a plant as a team of processes over Zenoh, recorded.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own; ends them all; prints what the run
    came to.
    """
    from launch_scripts.run_command import RunRequest, run

    request = RunRequest(
        "launch", scenario, start, duration, pace, seed, scheme, actuator, out, data, json, report
    )
    raise typer.Exit(run(request, _began_at))


@app.command("simulate", epilog="Example: heliarch simulate valley --seed 8 --json -")
def simulate_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: ReportFlag = False,
) -> None:
    """Run the same agents in this one process: the same messages, the same recording."""
    from launch_scripts.run_command import RunRequest, run

    request = RunRequest(
        "simulate", scenario, start, duration, pace, seed, scheme, actuator, out, data, json, report
    )
    raise typer.Exit(run(request, _began_at))


@app.command("report", epilog="Example: heliarch report recordings/runs/oahu-20261121-120000-4711")
def report_command(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The HTML file; default report.html in the run's folder.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network."""
    from launch_scripts.report_command import report

    raise typer.Exit(report(run, out))


@app.command(
    "compare",
    epilog="Example: heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10",
)
def compare_command(
    scenario: ScenarioArgument = "oahu-day",
    start: StartOption = None,
    duration: DurationOption = None,
    days: Annotated[
        str | None,
        typer.Option(help="Dates, such as 2010-04-01..2010-04-30.", metavar="DATES"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds of synthetic clouds, such as 1..5,9.", metavar="SEEDS")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A field of the scenario and its values; each combination is a case.",
            metavar="FIELD=VALUES",
        ),
    ] = None,
    schemes: Annotated[
        str | None, typer.Option(help="Control schemes, with commas between.", metavar="NAMES")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Reference groups of grouping control: sizes (1,4,8), or inverters (inv01,inv07).",
            metavar="GROUPS",
        ),
    ] = None,
    show: Annotated[
        str, typer.Option(help="Figure to show of many cases.", metavar="FIGURE")
    ] = "control-caused",
    agents: Annotated[
        bool, typer.Option(help="Run the hierarchical schemes message by message.")
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes that share the cases.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler that shares the cases.", metavar="ADDRESS")
    ] = None,
    data: DataOption = None,
    report: Annotated[
        Path | None, typer.Option(help="Write an HTML report of one case.", metavar="FILE")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Put control schemes side by side: the paper's tables, for any day or for many."""
    from launch_scripts.study.compare_command import CompareRequest, compare

    request = CompareRequest(
        scenario,
        start,
        duration,
        days,
        seeds,
        settings or [],
        schemes,
        reference,
        show,
        agents,
        workers,
        scheduler,
        data,
        report,
        json,
    )
    raise typer.Exit(compare(request))


@app.command("clusters", epilog="Example: heliarch clusters oahu --random 50 --periods 1,30")
def clusters_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    periods: Annotated[
        str | None,
        typer.Option(
            help="How often the central controller acts, seconds; default 1,10,60 as the cycle "
            "allows.",
            metavar="SECONDS",
        ),
    ] = None,
    random: Annotated[int, typer.Option(help="How many random choices of clusters to try.")] = 20,
    scheme: SchemeOption = None,
    learn: Annotated[
        str | None,
        typer.Option(
            help="Choose clusters from the first part of the run, as long as this, run the rest.",
            metavar="TIME",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="A field of the scenario and its value.", metavar="FIELD=VALUE"),
    ] = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Show what virtual neighbours are worth beside geographic and random clusters."""
    from launch_scripts.study.clusters_command import ClustersRequest, clusters

    request = ClustersRequest(
        scenario, start, duration, periods, random, scheme, learn, settings or [], data, json
    )
    raise typer.Exit(clusters(request))


@app.command("scenarios", epilog="Example: heliarch scenarios")
def scenarios_command() -> None:
    """List the scenarios that come with Heliarch."""
    from launch_scripts.scenario import load_scenario, shipped_scenarios

    for name in shipped_scenarios():
        typer.echo(f"{name:14} {load_scenario(name).scenario.title}")


def main() -> None:
    """Run the command line."""
    app()
