"""A console that no fault of its reader ends: `heliarch timing ... | head` goes on to its end.

Who reads may leave, a terminal may be closed, a disk may be full, and an encoding may lack a
character: what was measured must outlast all of it.
"""

from __future__ import annotations

import codecs
import io
import os
import sys
from contextlib import suppress
from typing import Final, TextIO

from rich.console import Console

_LEGIBLE: Final = "heliarch.legible"
_IN_ASCII: Final = {"µ": "u", "·": ".", "█": "#", "…": "."}
"""What stands for a character that the encoding lacks, of the same width: columns stay in line."""


class LastingStream:
    """A text stream that leads nowhere once it cannot be written to any more.

    Parameters
    ----------
    stream
        Standard output or standard error.

    Attributes
    ----------
    lost
        Why it could not; empty if it could, or if its reader has left, which is no error.
    """

    def __init__(self, stream: TextIO) -> None:
        self.lost = ""
        self._stream = stream
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_LEGIBLE)

    @property
    def encoding(self) -> str:
        """Of the stream."""
        return self._stream.encoding

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the stream's number."""
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Write, as far as it can be."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._give_up(error)
        return len(text)

    def flush(self) -> None:
        """Flush, as far as it can be."""
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        let_go(self._stream)
        if not isinstance(error, BrokenPipeError):
            self.lost = f"{self._stream.name.strip('<>')}: {error.strerror}"
            with suppress(OSError):
                sys.stderr.write(f"heliarch: {self.lost}; the rest of it is not shown\n")


class LastingConsole(Console):
    """A console that falls silent where it cannot be written to, and rich would exit.

    Parameters
    ----------
    stderr
        Whether it writes to standard error, and not to standard output.
    width
        Its width; None: that of the terminal.
    """

    def __init__(self, *, stderr: bool = False, width: int | None = None) -> None:
        self._lasting = LastingStream(sys.stderr if stderr else sys.stdout)
        # rich asks for no more than what this has of a stream.
        super().__init__(file=self._lasting, stderr=stderr, width=width)  # type: ignore[arg-type]

    @property
    def lost(self) -> str:
        """Why some of it is not shown, see `LastingStream`."""
        return self._lasting.lost


def write_if_read(text: str) -> str:
    """Write to standard output in UTF-8, as far as somebody reads it; tell why it was not written.

    JSON is UTF-8 whatever the terminal can show.
    """
    stream = LastingStream(sys.stdout)
    stream.flush()
    try:
        sys.stdout.buffer.write(text.encode())
        sys.stdout.buffer.flush()
    except BrokenPipeError:
        let_go(sys.stdout)
    except OSError as error:
        let_go(sys.stdout)
        return f"stdout: {error.strerror}"
    return stream.lost


def let_go(stream: TextIO) -> None:
    """Let a stream lead nowhere: what is left in its buffer would be an error again at the exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _legible(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(_IN_ASCII.get(character, "?") for character in lacking), error.end


codecs.register_error(_LEGIBLE, _legible)
