"""`heliarch launch`: a plant as a team of processes over Zenoh."""

from __future__ import annotations

from typing import Final

from launch_scripts.commands.boundary import BEGAN_AT
from launch_scripts.commands.options import (
    ActuatorOption,
    BasePortOption,
    CpusOption,
    DataOption,
    DurationOption,
    EndOption,
    ExternalOption,
    ExternalTimeoutOption,
    FaultOption,
    JsonOption,
    OutOption,
    PaceOption,
    PageAddressOption,
    PageOption,
    PagePortOption,
    PriorityOption,
    ReportOption,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    SettingsOption,
    StartOption,
)

EXAMPLE: Final = "heliarch launch oahu --from 12:30 --duration 15m --pace 1"


def launch(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    end: EndOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    settings: SettingsOption = None,
    fault: FaultOption = None,
    external: ExternalOption = None,
    external_timeout: ExternalTimeoutOption = 60.0,
    base_port: BasePortOption = None,
    cpus: CpusOption = None,
    priority: PriorityOption = None,
    data: DataOption = None,
    page: PageOption = False,
    page_port: PagePortOption = None,
    page_address: PageAddressOption = None,
    out: OutOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> int:
    """Run a plant as a team of processes over Zenoh, recorded.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own; ends them all; prints the result.
    """
    from launch_scripts.commands.run import page_process, run_and_print
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.externals import ExternalOptions
    from launch_scripts.scenarios.machine_table import MachineOptions
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    request = RunRequest(
        "launch",
        with_settings(load_scenario(scenario, data), settings or ()),
        start,
        end,
        duration,
        pace,
        seed,
        scheme,
        actuator,
        out,
        faults=tuple(fault or ()),
        external=ExternalOptions(tuple(external or ()), external_timeout, base_port),
        machine=MachineOptions(tuple(cpus or ()), priority),
    )
    with page_process(page, page_address, page_port) as shown:
        return run_and_print(request, json, report, BEGAN_AT, shown)
