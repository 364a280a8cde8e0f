"""`heliarch compare`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    JsonOption,
    ScenarioArgument,
    StartOption,
)

EXAMPLE: Final = "heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10"


def compare(
    scenario: ScenarioArgument = "oahu-day",
    start: StartOption = None,
    duration: DurationOption = None,
    days: Annotated[
        str | None,
        typer.Option(help="Dates, such as 2010-04-01..2010-04-30.", metavar="DATES"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds of synthetic clouds, such as 1..5,9.", metavar="SEEDS")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A field of the scenario and its values; each combination is a case.",
            metavar="FIELD=VALUES",
        ),
    ] = None,
    schemes: Annotated[
        str | None, typer.Option(help="Control schemes, with commas between.", metavar="NAMES")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Reference groups of grouping control: sizes (1,4,8), or inverters (inv01,inv07).",
            metavar="GROUPS",
        ),
    ] = None,
    show: Annotated[
        str, typer.Option(help="Figure to show of many cases.", metavar="FIGURE")
    ] = "control-caused",
    agents: Annotated[
        bool, typer.Option(help="Run the hierarchical schemes message by message.")
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes that share the cases.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler that shares the cases.", metavar="ADDRESS")
    ] = None,
    data: DataOption = None,
    report: Annotated[
        Path | None, typer.Option(help="Write an HTML report of one case.", metavar="FILE")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Put control schemes side by side: the paper's tables, for any day or for many."""
    from launch_scripts.commands.compare_work import CompareRequest
    from launch_scripts.commands.compare_work import compare as compare_work

    request = CompareRequest(
        scenario,
        start,
        duration,
        days,
        seeds,
        settings or [],
        schemes,
        reference,
        show,
        agents,
        workers,
        scheduler,
        data,
        report,
        json,
    )
    raise typer.Exit(compare_work(request))
