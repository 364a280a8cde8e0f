"""The command line: `heliarch`."""

# Commands import what they need themselves: `--help` must not wait for pvlib.
# ruff: noqa: PLC0415

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

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
OutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the run; default recordings/runs/NAME-TIME.", metavar="DIR"),
]
DataOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the data files that the scenario names.", metavar="DIR"),
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
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Run a plant as a team of processes over Zenoh, recorded.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own; ends them all; prints what the run
    came to.
    """
    from launch_scripts.run_command import RunRequest, run

    request = RunRequest("launch", scenario, start, duration, pace, seed, out, data, json)
    raise typer.Exit(run(request, _began_at))


@app.command("simulate", epilog="Example: heliarch simulate valley --seed 8 --json -")
def simulate_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Run the same agents in this one process: the same messages, the same recording."""
    from launch_scripts.run_command import RunRequest, run

    request = RunRequest("simulate", scenario, start, duration, pace, seed, out, data, json)
    raise typer.Exit(run(request, _began_at))


@app.command("scenarios", epilog="Example: heliarch scenarios")
def scenarios_command() -> None:
    """List the scenarios that come with Heliarch."""
    from launch_scripts.scenario import load_scenario, shipped_scenarios

    for name in shipped_scenarios():
        typer.echo(f"{name:14} {load_scenario(name).scenario.title}")


def main() -> None:
    """Run the command line."""
    app()
