"""`heliarch launch`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from typing import Final

import typer

from launch_scripts.commands.options import (
    ActuatorOption,
    BasePortOption,
    CpusOption,
    DataOption,
    DurationOption,
    ExternalOption,
    ExternalTimeoutOption,
    FaultOption,
    JsonOption,
    OutOption,
    PaceOption,
    PriorityOption,
    ReportFlag,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    StartOption,
)

EXAMPLE: Final = "heliarch launch oahu --start 12:30 --duration 15m"


def launch(
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
    external: ExternalOption = None,
    external_timeout: ExternalTimeoutOption = 60.0,
    base_port: BasePortOption = None,
    cpus: CpusOption = None,
    priority: PriorityOption = None,
) -> None:
    """Run a plant as a team of processes over Zenoh, recorded.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own; ends them all; prints what the run
    came to.
    """
    from launch_scripts.commands.boundary import BEGAN_AT
    from launch_scripts.commands.run import run
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.externals import ExternalOptions
    from launch_scripts.scenarios.machine_table import MachineOptions

    request = RunRequest(
        "launch",
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
        external=ExternalOptions(tuple(external or ()), external_timeout, base_port),
        machine=MachineOptions(tuple(cpus or ()), priority),
    )
    raise typer.Exit(run(request, BEGAN_AT))
