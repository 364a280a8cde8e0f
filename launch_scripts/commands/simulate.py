"""`heliarch simulate`: the agents of a plant in one process."""

from __future__ import annotations

from launch_scripts.commands.options import FileOptions, PageOptions, SpanOptions
from launch_scripts.scenarios.run_options import PlantOptions


def simulate(
    scenario: str = "oahu",
    *,
    span: SpanOptions,
    plant: PlantOptions,
    settings: list[str] | None = None,
    page: PageOptions,
    files: FileOptions,
) -> int:
    """Run a plant's agents in one process: the same messages and recording as `launch`.

    Example: heliarch simulate valley --seed 8 --set commitment.share=0.4 --report
    """
    from launch_scripts.commands.run import run_and_print, run_request

    request = run_request(scenario, settings, files, **vars(span), **vars(plant))
    return run_and_print(request, files, page)
