"""`heliarch view`: a recording, or the runs in a folder, in a browser."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import OK

if TYPE_CHECKING:
    from live_page.foxglove_stream import FoxgloveStream
    from live_page.server import PageServer


def view(
    path: Path = Path("runs"),
    page_port: int | None = None,
    page_address: str | None = None,
    foxglove: int | None = None,
) -> int:
    """Show a run in a browser, with play, pause and seek, also while it is being recorded.

    For a folder of runs, lists the runs with their figures. Ends with Ctrl-C.

    PATH: Folder of a run, its run.mcap, or a folder of runs.
    --foxglove PORT 1..65535: Also stream the run to Foxglove or Lichtblick, which connect to this
        port; their default is 8765. Needs the extra `foxglove`.
    Example: heliarch view runs/oahu-20261121-120000-4711
    """
    from live_page.place import open_place
    from live_page.process import get_behind_others
    from live_page.server import PageServer
    from recordings.inspect.health import SUMMARY_NAME

    several = _holds_several(path)
    if several and foxglove is not None:
        raise InputError(f"--foxglove: expected one run with it, got the runs in {path}")
    place = open_place(page_address, page_port)
    stream = None if foxglove is None else _foxglove_stream(path, foxglove)
    typer.echo(f"page: {place.address()}   (Ctrl-C ends it)")
    if not several and not (path if path.is_dir() else path.parent).joinpath(SUMMARY_NAME).exists():
        get_behind_others()  # Its run may go on.
    if stream is not None:
        layout = place.address("layout.json")
        typer.echo(f"foxglove: ws://127.0.0.1:{foxglove}   (layout: {layout})")
    return asyncio.run(_serve(PageServer(path, place, several=several), stream))


def _holds_several(path: Path) -> bool:
    """Tell a folder of runs from a run, which may not have begun yet."""
    from live_page.run_list import recordings_in
    from recordings.read.reader import RunReader
    from recordings.read.run_file import RECORDING_NAME

    is_run = any((path / name).exists() for name in (RECORDING_NAME, "plan.json"))
    if path.is_dir() and not is_run:
        if not recordings_in(path):
            raise InputError(f"{path}: expected a run or a folder with runs, got neither")
        return True
    if not (path / "plan.json").exists():  # Otherwise it may not have begun.
        RunReader(path).close()
    return False


def _foxglove_stream(path: Path, port: int) -> FoxgloveStream:
    from live_page.foxglove_stream import FoxgloveStream
    from live_page.run_view import RunView

    return FoxgloveStream(RunView(path), port)


async def _serve(server: PageServer, stream: FoxgloveStream | None) -> int:
    """Serve until a signal comes; return the exit status. Ctrl-C is the way to end it."""
    status = OK

    def end(number: int) -> None:
        nonlocal status
        status = OK if number == signal.SIGINT else 128 + number
        server.end()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, end, number)
    tasks = [asyncio.create_task(server.serve())]
    if stream is not None:
        tasks.append(asyncio.create_task(stream.serve()))
    done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in done:
        task.result()
    return status
