"""Starts and ends a process beside a run, such as the page."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from typing import Any, Final, Self

ENDING_S: Final = 6.0
"""How long such a process may take to end: the fork server waits 5 s for the recorder."""


class SideProcess:
    """A module as a process. It reads lines from its standard input, and ends with the context."""

    def __init__(self, module: str, *words: str, **options: Any) -> None:
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            # Without the current folder on the path: a `signal.py` there is none of ours.
            (sys.executable, "-P", "-m", module, *words),
            stdin=subprocess.PIPE,
            bufsize=0,
            process_group=0,  # Ctrl-C in a terminal is for the launcher.
            **options,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let it end; kill it if it does not."""
        self.hang_up()
        try:
            self.process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def tell(self, line: bytes) -> None:
        """Send a line; a process that has ended ignores it."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.write(line + b"\n")

    def hang_up(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
