"""`heliarch timing`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    ActuatorOption,
    BasePortOption,
    CpusOption,
    DataOption,
    ExternalOption,
    ExternalTimeoutOption,
    FaultOption,
    JsonOption,
    OutOption,
    PriorityOption,
    SchemeOption,
    SeedOption,
    StartOption,
)

EXAMPLE: Final = "heliarch timing oahu --rate 20 --duration 60s --report"


def timing(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="A shipped scenario or a TOML file, default oahu; or the "
            "folder or run.mcap of a run that was in real time: nothing is run then.",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            help="Cycles a second: 20; several: 5,10,20; a range or auto: find the highest rate "
            "that the plant keeps up with. Default 1.",
            metavar="RATES",
        ),
    ] = None,
    duration: Annotated[
        str | None,
        typer.Option(
            help="Length of the run, simulated and real: seconds, or 90s, 10m; default 60s, 15s "
            "for each of several rates.",
            metavar="TIME",
        ),
    ] = None,
    start: StartOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write an HTML page into the run's folder.")
    ] = False,
    processes: Annotated[
        bool, typer.Option("--processes", help="Show each process, not the tiers alone.")
    ] = False,
    fault: FaultOption = None,
    external: ExternalOption = None,
    external_timeout: ExternalTimeoutOption = 60.0,
    base_port: BasePortOption = None,
    cpus: CpusOption = None,
    priority: PriorityOption = None,
) -> None:
    """Run a plant in real time and report whether every tier meets its deadlines, and by how much.

    With a recorded run instead of a scenario, report on that.

    Exit status 1: a budget was not kept, or the run failed. A scenario states its own budgets in
    its table timing.budgets; see docs/timing.md.
    """
    from launch_scripts.commands.timing_work import TimingRequest
    from launch_scripts.commands.timing_work import timing as timing_work
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.externals import ExternalOptions
    from launch_scripts.scenarios.machine_table import MachineOptions

    run = RunRequest(
        "launch",
        scenario or "oahu",
        start,
        None,
        None,
        seed,
        scheme,
        actuator,
        out,
        data,
        json,
        report=False,
        faults=tuple(fault or ()),
        external=ExternalOptions(tuple(external or ()), external_timeout, base_port),
        machine=MachineOptions(tuple(cpus or ()), priority),
    )
    request = TimingRequest(run, scenario, rate, duration, processes, report)
    raise typer.Exit(timing_work(request))
