"""`heliarch view`: a recording, or the runs in a folder, in a browser."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import PageAddressOption, PagePortOption

EXAMPLE: Final = "heliarch view runs/oahu-20261121-120000-4711"


def view(
    path: Annotated[
        Path,
        typer.Argument(help="Folder of a run, its run.mcap, or a folder of runs."),
    ] = Path("runs"),
    page_port: PagePortOption = None,
    page_address: PageAddressOption = None,
) -> None:
    """Show a run in a browser: play, pause and scrub it, also while it is being recorded.

    Of a folder it lists the runs with their figures. Ends with Ctrl-C.
    """
    from live_page.place import open_place
    from live_page.run_list import RunList
    from live_page.server import PageServer
    from recordings.read.reader import RunReader
    from recordings.read.run_file import RECORDING_NAME, NothingRecordedError

    recording, begun = path / RECORDING_NAME, (path / "plan.json").exists()
    several = path.is_dir() and not recording.exists() and not begun
    if several and not RunList(path).recordings():
        raise InputError(f"{path}: expected a run or a folder with runs, got neither")
    if not several and (recording.exists() or not begun):
        try:
            RunReader(path).close()
        except NothingRecordedError:
            if not begun:
                raise
    place = open_place(page_address, page_port)
    typer.echo(f"page: {place.address}   (Ctrl-C ends it)")
    with suppress(KeyboardInterrupt):
        asyncio.run(PageServer(path, place, several=several).serve())
