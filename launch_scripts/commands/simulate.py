"""`heliarch simulate`: the agents of a plant in one process."""

from __future__ import annotations

from typing import Final

from launch_scripts.commands.boundary import BEGAN_AT
from launch_scripts.commands.options import (
    ActuatorOption,
    DataOption,
    DurationOption,
    EndOption,
    FaultOption,
    JsonOption,
    OutOption,
    PaceOption,
    PageAddressOption,
    PageOption,
    PagePortOption,
    ReportOption,
    ScenarioArgument,
    SchemeOption,
    SeedOption,
    SettingsOption,
    StartOption,
)

EXAMPLE: Final = "heliarch simulate valley --seed 8 --set commitment.share=0.4 --report"


def simulate(
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
    data: DataOption = None,
    page: PageOption = False,
    page_port: PagePortOption = None,
    page_address: PageAddressOption = None,
    out: OutOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> int:
    """Run the same agents in one process, with the same messages and recording."""
    from launch_scripts.commands.run import page_process, run_and_print
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    request = RunRequest(
        "simulate",
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
    )
    with page_process(page, page_address, page_port) as shown:
        return run_and_print(request, json, report, BEGAN_AT, shown)
