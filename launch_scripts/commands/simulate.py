"""`heliarch simulate`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from typing import Final

import typer

from launch_scripts.commands.options import (
    ActuatorOption,
    DataOption,
    DurationOption,
    FaultOption,
    JsonOption,
    OutOption,
    PaceOption,
    ReportFlag,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    StartOption,
)

EXAMPLE: Final = "heliarch simulate valley --seed 8 --json -"


def simulate(
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
    fault: FaultOption = None,
) -> None:
    """Run the same agents in this one process: the same messages, the same recording."""
    from launch_scripts.commands.boundary import BEGAN_AT
    from launch_scripts.commands.run import run
    from launch_scripts.launcher.request import RunRequest

    request = RunRequest(
        "simulate",
        scenario,
        start,
        duration,
        pace,
        seed,
        scheme,
        actuator,
        out,
        data,
        json,
        report,
        faults=tuple(fault or ()),
    )
    raise typer.Exit(run(request, BEGAN_AT))
