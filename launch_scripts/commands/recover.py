"""`heliarch recover`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import JsonOption

EXAMPLE: Final = "heliarch recover RUN --out whole.mcap"


def recover(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The new file; default run.recovered.mcap beside the recording.", metavar="FILE"
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Make a whole recording of one that a crash or a full disk has cut.

    Exit status: 0 if nothing is missing, 3 if something is or may be,
    1 if there is nothing to recover.
    """
    from launch_scripts.commands.recover_work import recover as recover_work

    raise typer.Exit(recover_work(run, out, json))
