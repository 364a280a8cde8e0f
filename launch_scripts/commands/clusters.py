"""`heliarch clusters`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from typing import Annotated, Final

import typer

from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    JsonOption,
    ScenarioArgument,
    SchemeOption,
    StartOption,
)

EXAMPLE: Final = "heliarch clusters oahu --random 50 --periods 1,30"


def clusters(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    periods: Annotated[
        str | None,
        typer.Option(
            help="How often the central controller acts, seconds; default 1,10,60 as the cycle "
            "allows.",
            metavar="SECONDS",
        ),
    ] = None,
    random: Annotated[int, typer.Option(help="How many random choices of clusters to try.")] = 20,
    scheme: SchemeOption = None,
    learn: Annotated[
        str | None,
        typer.Option(
            help="Choose clusters from the first part of the run, as long as this, run the rest.",
            metavar="TIME",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="A field of the scenario and its value.", metavar="FIELD=VALUE"),
    ] = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Show what virtual neighbours are worth beside geographic and random clusters."""
    from launch_scripts.commands.clusters_work import ClustersRequest
    from launch_scripts.commands.clusters_work import clusters as clusters_work

    request = ClustersRequest(
        scenario, start, duration, periods, random, scheme, learn, settings or [], data, json
    )
    raise typer.Exit(clusters_work(request))
