"""Where every command begins and ends: signals, errors and exit status."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from types import FrameType
from typing import Any, Final, NoReturn

from cyclopts.exceptions import CycloptsError

from bus_schemas.errors import FailureError, InputError, InputWarning, printable

BEGAN_AT: Final = time.monotonic()
"""When the program was started [s]."""

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Ctrl-C: 128 and the number of the signal, as shells count. So SIGTERM is 143, SIGHUP 129."""

_ONCE_S: Final = 1.0
"""Signals so soon after each other count as one: `timeout` sends two."""

_BAD_INPUT: Final = (
    InputError,
    CycloptsError,
    FileExistsError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
_EXTRAS: Final = {"cryptography": "keys", "pymodbus": "modbus", "sunspec2": "modbus"}
"""Packages that not every user needs, and the extra that installs them."""


@contextmanager
def boundary() -> Iterator[None]:
    """Turn errors and signals into one line on standard error and an exit status.

    Ctrl-C raises KeyboardInterrupt, SIGTERM and SIGHUP raise SystemExit, so that every `with` and
    `finally` cleans up. A signal that is ignored (`nohup`) stays ignored.
    """
    handle = _handler()
    before = {
        number: signal.signal(number, handle)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        with warnings.catch_warnings():
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            yield
    except BrokenPipeError:  # `heliarch ... | head`: the reader has left.
        _discard_output()
        sys.exit(FAILED)
    except _BAD_INPUT as error:
        _end(_text(error), BAD_INPUT)
    except (FailureError, OSError, MemoryError) as error:
        _end(_text(error), FAILED)
    except KeyboardInterrupt:
        _end("interrupted", INTERRUPTED)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        extra = f"pip install 'heliarch[{_EXTRAS[error.name]}]'"
        _end(f"{error.name} is not installed: {extra}", BAD_INPUT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _show_warning(
    show_others: Callable[..., None], message: object, category: type, *place: Any
) -> None:
    if issubclass(category, InputWarning):
        complain(message, OK)
    else:
        show_others(message, category, *place)


def complain(text: object, status: int) -> int:
    """Say on standard error what is wrong; return the exit status."""
    sys.stderr.write(f"heliarch: {printable(str(text))}\n")
    return status


class _Interrupt(KeyboardInterrupt):
    """Ctrl-C, as a subclass of KeyboardInterrupt.

    If a plain KeyboardInterrupt passes through an `exec`, which makes named tuples and data classes
    while modules are imported, Python ends itself by SIGINT, without an exit status.
    """


def _handler() -> Callable[[int, FrameType | None], None]:
    """Return what raises for a signal, but for one that follows at once."""
    raised_at = -inf

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal raised_at
        if time.monotonic() >= raised_at + _ONCE_S:
            raised_at = time.monotonic()
            raise _Interrupt if number == signal.SIGINT else SystemExit(128 + number)

    return handle


def _text(error: Exception) -> str:
    if isinstance(error, CycloptsError):
        return " ".join(str(error).split())
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or "not enough memory"


def _end(text: str, status: int) -> NoReturn:
    try:
        sys.stdout.flush()
    except OSError:  # At the end of the process, the rest of the buffer would fail again.
        _discard_output()
    sys.exit(complain(text, status))


def _discard_output() -> None:
    with suppress(OSError, ValueError):  # A test's standard output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
