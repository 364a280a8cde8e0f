"""`heliarch simulate`: the agents of a plant in one process."""

from __future__ import annotations

from bus_schemas.errors import InputError
from heliarch.cli.options import (
    FileOptions,
    PageOptions,
    Scenario,
    Settings,
    changed_scenario,
)
from scenarios.run_options import PlantOptions, RunOptions, SpanOptions


def simulate(
    scenario: Scenario = "oahu",
    /,
    *,
    plant: PlantOptions = PlantOptions(),
    settings: Settings = None,
    span: SpanOptions = SpanOptions(),
    page: PageOptions = PageOptions(),
    files: FileOptions = FileOptions(),
) -> int:
    """Run a plant in one process, and record it as `launch` does.

    Example: `heliarch simulate valley --seed 8 --set commitment.share=0.4 --report`
    """
    from heliarch.cli.run import run_and_print

    if page.orders:
        raise InputError.of(
            "--orders", "expected none, since only the plant of `launch` takes them"
        )
    options = RunOptions.of(span, plant)
    return run_and_print(changed_scenario(scenario, files.data, settings), options, files, page)
