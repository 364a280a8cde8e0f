"""The page's process beside a run, started by `PageProcess`."""

from __future__ import annotations

import asyncio
import socket
import sys
from pathlib import Path
from typing import Final

import msgspec

from live_page.process import PageAddress, PageSettings, get_behind_others
from live_page.server import PageServer

_LAST_NEWS_S: Final = 0.5
"""For browsers to learn that the run has failed."""

_RELOAD_S: Final = 2.0
"""A browser that reloads the page is away for a moment."""


async def _serve() -> None:
    over = asyncio.StreamReader()
    protocol = asyncio.StreamReaderProtocol(over)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    first = await over.readline()
    if not first:
        return
    settings = msgspec.json.decode(first, type=PageSettings)
    address = PageAddress(socket.socket(fileno=settings.socket), settings.token)
    server = PageServer(
        Path(settings.path), address, several=settings.several, orders=settings.orders
    )
    serving = asyncio.create_task(server.serve())
    if await over.readline():
        gone = asyncio.create_task(over.read())
        clock = asyncio.get_running_loop().time
        while not gone.done():
            if not server.streams and clock() > server.left_at + _RELOAD_S:
                break
            await asyncio.sleep(0.1)
        gone.cancel()
    else:
        await asyncio.sleep(_LAST_NEWS_S)
    server.end()
    await serving


def main() -> None:
    """Serve a page beside a run, behind the run's own processes."""
    get_behind_others()
    asyncio.run(_serve())


if __name__ == "__main__":
    main()
