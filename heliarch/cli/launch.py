"""`heliarch launch`: a plant as a team of processes over Zenoh."""

from __future__ import annotations

from heliarch.cli.options import (
    FileOptions,
    PageOptions,
    Scenario,
    Settings,
    changed_scenario,
)
from scenarios.run_options import PlantOptions, ProcessOptions, RunOptions, SpanOptions


def launch(
    scenario: Scenario = "oahu",
    /,
    *,
    plant: PlantOptions = PlantOptions(),
    settings: Settings = None,
    span: SpanOptions = SpanOptions(),
    processes: ProcessOptions = ProcessOptions(),
    page: PageOptions = PageOptions(),
    files: FileOptions = FileOptions(),
) -> int:
    """Run a plant as a team of processes over Zenoh, and record it.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own. At the end it stops them all and
    prints the result.

    Example: `heliarch launch oahu --from 12:30 --duration 15m --pace 1`
    """
    from launch_scripts.fork_server_process import fork_server

    with fork_server() as server:  # It imports what its processes need, beside the launcher.
        from heliarch.cli.run import run_and_print

        options = RunOptions.of(span, plant, processes)
        file = changed_scenario(scenario, files.data, settings)
        return run_and_print(file, options, files, page, server)
