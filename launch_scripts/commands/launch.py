"""`heliarch launch`: a plant as a team of processes over Zenoh."""

from __future__ import annotations

from launch_scripts.commands.options import FileOptions, PageOptions, SpanOptions
from launch_scripts.scenarios.run_options import PlantOptions, ProcessOptions


def launch(
    scenario: str = "oahu",
    *,
    span: SpanOptions,
    plant: PlantOptions,
    settings: list[str] | None = None,
    processes: ProcessOptions,
    page: PageOptions,
    files: FileOptions,
) -> int:
    """Run a plant as a team of processes over Zenoh, and record it.

    Starts the plant simulator, a direct controller for each inverter, the
    supervisors, the central controller and the recorder, each as a process
    of its own. At the end it stops them all and prints the result.

    Example: heliarch launch oahu --from 12:30 --duration 15m --pace 1
    """
    from launch_scripts.launcher.supervision import ForkServerProcess

    with ForkServerProcess() as server:  # It imports what its processes need, beside the launcher.
        from launch_scripts.commands.run import run_and_print, run_request

        options = {**vars(span), **vars(plant), **vars(processes)}
        request = run_request(scenario, settings, files, **options)
        return run_and_print(request, files, page, server)
