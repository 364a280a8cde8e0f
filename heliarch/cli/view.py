"""`heliarch view`: a recording, or the runs in a folder, in a browser."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from bus_schemas.errors import InputError
from heliarch.cli.boundary import OK
from heliarch.cli.options import PageAddress, PagePort
from heliarch.cli.output import Output
from live_page.process import get_behind_others, open_address

if TYPE_CHECKING:
    from live_page.server import PageServer


def view(
    path: Path = Path("runs"),
    /,
    *,
    page_port: PagePort = None,
    page_address: PageAddress = None,
) -> int:
    """Show a run in a browser, also while it is being recorded.

    With play, pause and seek.

    For a folder of runs, lists the runs with their figures. Ends with Ctrl-C.

    Example: `heliarch view runs/oahu-20261121-120000-4711`

    Parameters
    ----------
    path
        Folder of a run, its run.mcap, or a folder of runs.
    """
    from live_page.server import PageServer
    from recordings.read.run_file import SUMMARY_NAME

    several = _holds_several(path)
    address = open_address(page_address, page_port)
    Output().say(f"page: {address.text()}   (Ctrl-C ends it)")
    if not several and not (path if path.is_dir() else path.parent).joinpath(SUMMARY_NAME).exists():
        get_behind_others()  # Its run may go on.
    return asyncio.run(_serve(PageServer(path, address, several=several)))


def _holds_several(path: Path) -> bool:
    """Tell a folder of runs from a run, which may not have begun yet."""
    from live_page.run_list import recordings_in
    from recordings.read.reader import RunReader
    from recordings.read.run_file import RECORDING_NAME

    if (path / "plan.json").exists():
        return False
    if path.is_dir() and not (path / RECORDING_NAME).exists():
        if not recordings_in(path):
            raise InputError(f"{path}: expected a run or a folder with runs, got neither")
        return True
    RunReader(path).close()
    return False


async def _serve(server: PageServer) -> int:
    """Serve until a signal comes; return the exit status. Ctrl-C is its normal end."""
    status = OK

    def end(number: int) -> None:
        nonlocal status
        status = OK if number == signal.SIGINT else 128 + number
        server.end()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            asyncio.get_running_loop().add_signal_handler(number, end, number)
    await server.serve()
    return status
