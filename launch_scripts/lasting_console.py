"""A console whose reader may leave: `heliarch timing ... | head` goes on to its end, in silence."""

from __future__ import annotations

import os
import sys
from typing import TextIO

from rich.console import Console


class LastingConsole(Console):
    """A console that falls silent when nobody reads it any more, where rich would exit."""

    def on_broken_pipe(self) -> None:
        """Say nothing from here on."""
        self.quiet = True
        let_go(sys.stderr if self.stderr else sys.stdout)


def write_if_read(text: str) -> None:
    """Write to standard output, as far as somebody reads it."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        let_go(sys.stdout)


def let_go(stream: TextIO) -> None:
    """Let a stream lead nowhere: what is left in its buffer would be an error again at the exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
