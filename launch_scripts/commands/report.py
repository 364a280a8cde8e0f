"""`heliarch report`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

EXAMPLE: Final = "heliarch report runs/oahu-20261121-120000-4711"


def report(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The HTML file; default report.html in the run's folder.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network."""
    from launch_scripts.commands.report_work import report as report_work

    raise typer.Exit(report_work(run, out))
