"""The page as a process of its own beside a run, and the launcher's hold on it.

The launcher writes the settings to the process's standard input, and `over` when the run is. The
process then ends as soon as nobody looks on; when the launcher is gone, at once.
"""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from live_page.server import PageServer, Place

_NICE: Final = 10
_RELOAD_S: Final = 3.0
"""A browser that reloads the page is away for a moment."""


class PageSettings(msgspec.Struct):
    """What the process serves."""

    path: str
    several: bool
    socket: int
    token: str


class PageProcess:
    """The page's process, as its launcher sees it.

    Parameters
    ----------
    path, several
        The folder of the run, or that of several runs; it may be made later.
    place
        Where to serve it.
    """

    def __init__(self, path: Path, place: Place, *, several: bool = False) -> None:
        number = place.socket.fileno()
        self._process = subprocess.Popen(
            (sys.executable, "-P", "-m", "live_page.process"),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            pass_fds=(number,),
            process_group=0,  # Ctrl-C in a terminal is for the launcher.
        )
        place.socket.close()
        self._tell(msgspec.json.encode(PageSettings(str(path), several, number, place.token)))

    def let_end(self, say: Callable[[str], None]) -> None:
        """Wait until nobody looks at the page any more, or until Ctrl-C."""
        self._tell(b"over")
        with suppress(KeyboardInterrupt):
            try:
                self._process.wait(_RELOAD_S)
            except subprocess.TimeoutExpired:
                say("page: still open in a browser; close it there or press Ctrl-C to end")
                self._process.wait()

    def end(self) -> None:
        """End it at once."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(_RELOAD_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _tell(self, line: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(line + b"\n")
            self._process.stdin.flush()


async def _serve(settings: PageSettings, over: asyncio.StreamReader) -> None:
    place = Place(socket.socket(fileno=settings.socket), settings.token)
    server = PageServer(Path(settings.path), place, several=settings.several)
    serving = asyncio.create_task(server.serve())
    if await over.readline():
        gone = asyncio.create_task(over.read())
        clock = asyncio.get_running_loop().time
        while not gone.done():
            audience = server.audience
            if not audience.streams and clock() > audience.left_at + _RELOAD_S:
                break
            await asyncio.sleep(0.1)
        gone.cancel()
    server.end()
    await serving


async def _main() -> None:
    reader = asyncio.StreamReader()
    protocol = asyncio.StreamReaderProtocol(reader)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    settings = await reader.readline()
    if settings:
        await _serve(msgspec.json.decode(settings, type=PageSettings), reader)


def main() -> None:
    """Serve a page beside a run, behind the run's own processes."""
    os.nice(_NICE)
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    asyncio.run(_main())


if __name__ == "__main__":
    main()
