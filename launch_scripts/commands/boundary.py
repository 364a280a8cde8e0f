"""Where every command begins and ends: signals, errors and exit status."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from bus_schemas.errors import FailureError, InputError

BEGAN_AT: Final = time.monotonic()
"""When the program was started [s]."""

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Ctrl-C: 128 and the number of the signal, as shells count. So SIGTERM is 143, SIGHUP 129."""

_BAD_PATH: Final = (
    FileExistsError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
_UsageError: Final[Any] = typer.BadParameter.__mro__[1]
"""What typer raises for an option or argument that it cannot accept."""


class CommandLine(TyperGroup):
    """The command line. Its commands return their exit status, or None for success."""

    def main(self, *args: Any, **options: Any) -> NoReturn:
        """Run the command that the user named, and leave with its exit status."""
        options["standalone_mode"] = False
        with boundary():
            status = super().main(*args, **options)
            sys.stdout.flush()
        sys.exit(status or OK)


class Command(TyperCommand):
    """One command, whose `--report` may be followed by a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - Typer's type is private
        """Read the words after the command."""
        return super().parse_args(ctx, _with_report_value(args))


def _with_report_value(args: list[str]) -> list[str]:
    """Give a bare `--report` an empty value. The word after it is its file if it ends in .html."""
    found = []
    for word, following in zip(args, [*args[1:], ""], strict=False):
        is_bare = word == "--report" and not following.endswith(".html")
        found.append("--report=" if is_bare else word)
    return found


@contextmanager
def boundary() -> Iterator[None]:
    """Turn errors and signals into one line on standard error and an exit status.

    SIGTERM and SIGHUP raise SystemExit, so that every `with` and `finally` cleans up. A signal
    that is ignored (`nohup`) stays ignored.
    """
    before = {
        number: signal.signal(number, _leave)
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    except BrokenPipeError:  # `heliarch ... | head`: nobody reads on.
        _discard_output()
        sys.exit(FAILED)
    except (InputError, *_BAD_PATH) as error:
        _end(_text(error), BAD_INPUT)
    except (FailureError, OSError) as error:
        _end(_text(error), FAILED)
    except (KeyboardInterrupt, typer.Abort):
        _end("interrupted", INTERRUPTED)
    except _UsageError as error:
        _end(error.format_message(), BAD_INPUT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def complain(text: object, status: int) -> int:
    """Say on standard error what is wrong; return the exit status."""
    sys.stderr.write(f"heliarch: {text}\n")
    return status


def _leave(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)  # `timeout` sends its signal twice.
    sys.exit(128 + number)


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _end(text: str, status: int) -> NoReturn:
    try:
        sys.stdout.flush()
    except OSError:  # What is left in the buffer would fail once more at the end of the process.
        _discard_output()
    sys.exit(complain(text, status))


def _discard_output() -> None:
    with suppress(OSError, ValueError):  # A test's standard output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
