"""`heliarch verify`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import JsonOption

EXAMPLE: Final = "heliarch verify runs/oahu-20261121-120000-4711 --node 'c2/*'"


def verify(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of runs, or their run.mcap.", metavar="RUN...", show_default=False
        ),
    ],
    nodes: Annotated[
        list[str] | None,
        typer.Option(
            "--node",
            help="Agents to re-run: plant, central, c2, c2/inv07; c2/*: c2 and all below it.",
            metavar="NAMES",
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Largest difference of two equal floats.", metavar="X")
    ] = 0.0,
    ignored: Annotated[
        list[str] | None,
        typer.Option("--ignore", help="Fields that may differ.", metavar="FIELDS"),
    ] = None,
    accept: Annotated[
        bool,
        typer.Option("--accept", help="Replace the recording by what the agents do now."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Re-run the agents of a recording on the inputs that they used, and compare what they say.

    Exit status 1: they differ, each agent's first difference is shown with its inputs; or what was
    lost leaves it undecided.
    """
    from launch_scripts.commands.verify_work import VerifyRequest, run_verify

    request = VerifyRequest(runs, nodes or [], tolerance, ignored or [], accept, json)
    raise typer.Exit(run_verify(request))
