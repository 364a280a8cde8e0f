"""The page as a process of its own beside a run, and the launcher's hold on it.

The launcher writes the settings to the process's standard input, and `over` when the run is. The
process then ends as soon as nobody looks on; when the launcher is gone, at once.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from agents.side_process import SideProcess
from live_page.place import open_place

_CLOSING_S: Final = 3.0
_NICE: Final = 10


class PageSettings(msgspec.Struct):
    """What the process serves."""

    path: str
    several: bool
    socket: int
    token: str


class PageProcess(SideProcess):
    """The page's process, as its launcher sees it. It ends with the context."""

    def __init__(self, address: str | None, port: int | None) -> None:
        self._place = open_place(address, port)
        super().__init__(
            "live_page",
            stdout=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            pass_fds=(self._place.socket.fileno(),),
        )

    def __exit__(self, *error: object) -> None:
        self._place.socket.close()
        super().__exit__()

    def show(self, path: Path, *, several: bool = False) -> str:
        """Serve the run in a folder, or the `several` runs there; return the address to open.

        The folder may be made later.
        """
        number, token = self._place.socket.fileno(), self._place.token
        settings = PageSettings(str(path.absolute()), several, number, token)
        self.tell(msgspec.json.encode(settings))
        return self._place.address()

    def let_end(self, say: Callable[[str], None]) -> None:
        """Wait until nobody looks at the page any more, or until Ctrl-C."""
        self.tell(b"over")
        with suppress(KeyboardInterrupt):
            try:
                self.process.wait(_CLOSING_S)
            except subprocess.TimeoutExpired:
                say("page: still open in a browser; close it there or press Ctrl-C to end")
                self.process.wait()


def get_behind_others() -> None:
    """Let this process run when no other wants the core.

    In lockstep the processes of a run do not interrupt one of the normal policies when they wake.
    """
    os.nice(_NICE)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
