"""`heliarch inspect`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import JsonOption

EXAMPLE: Final = "heliarch inspect RUN --node c2/inv07 --from 13:49:00 --to 13:50:30"


def inspect(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    node: Annotated[
        str | None,
        typer.Option(
            help="Tell this node's story, cycle by cycle: c2/inv07, c1 or central.", metavar="NODE"
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="MOMENT"),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option("--to", help="Last cycle, likewise.", metavar="MOMENT"),
    ] = None,
    cycle: Annotated[
        str | None,
        typer.Option(help="Show the whole plant in one cycle, likewise.", metavar="MOMENT"),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show what a recording holds, one node's story, or the whole plant in one cycle.

    Without --node and --cycle: scenario, duration, versions, messages and
    rate of each signal, and what is missing in between.
    """
    from launch_scripts.commands.inspect_work import InspectRequest
    from launch_scripts.commands.inspect_work import inspect as inspect_work

    raise typer.Exit(inspect_work(InspectRequest(run, node, start, end, cycle, json)))
