"""`heliarch export`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import JsonOption

EXAMPLE: Final = "heliarch export runs/oahu-20261121-120000-4711 --to csv"


def export(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    to: Annotated[
        str,
        typer.Option(
            help="json-mcap (for Foxglove and Lichtblick), parquet or csv.",
            metavar="FORM",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The file, or folder of tables, to make; default beside the recording.",
            metavar="PATH",
        ),
    ] = None,
    signals: Annotated[
        str | None,
        typer.Option(help="Only these, with commas between: impp,residual.", metavar="NAMES"),
    ] = None,
    nodes: Annotated[
        str | None,
        typer.Option(help="Only about these: c2/inv07,c2,central.", metavar="NODES"),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="MOMENT"),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option("--until", help="Last cycle, likewise.", metavar="MOMENT"),
    ] = None,
    clock: Annotated[
        str | None,
        typer.Option(
            help="Times that a viewer shows: wall (as recorded) or sim (those of the plant).",
            metavar="CLOCK",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Make a file for viewers, or tidy tables, of a recording."""
    from launch_scripts.commands.export_work import ExportRequest, run_export

    request = ExportRequest(run, to, out, signals, nodes, start, end, clock, json)
    raise typer.Exit(run_export(request))
