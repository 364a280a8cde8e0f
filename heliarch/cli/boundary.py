"""Where every command begins and ends: signals, errors and exit status."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from pathlib import Path
from types import FrameType
from typing import Any, Final, NoReturn

from cyclopts.exceptions import CycloptsError, MissingArgumentError, UnusedCliTokensError

from agents.process.interruption import ONCE_S
from bus_schemas.errors import FailureError, InputError, InputWarning, listed, printable

BEGAN_AT: Final = time.monotonic()
"""When the program was started [s]."""

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Ctrl-C: 128 and the number of the signal, as shells count. So SIGTERM is 143, SIGHUP 129.

A run that SIGTERM asked to end has this status too, since it ends like one after Ctrl-C.
"""

_IMPORTING: Final = "<frozen importlib._bootstrap>"
_IMPORT_S: Final = 0.02
"""How long a signal waits each time it finds that a module is being imported."""

_BAD_PATH: Final = (
    FileExistsError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
"""Bad input where the user named the path; elsewhere a failure."""

_EXTRAS: Final = {
    "cryptography": "keys",
    "numba": "compare",
    "plotly": "report",
    "pyarrow": "tables",
    "pymodbus": "modbus",
    "sunspec2": "modbus",
}
"""Packages that not every user needs, and the extra that installs them."""


@contextmanager
def boundary(words: Sequence[str] = (), *, debug: bool = False) -> Iterator[None]:
    """Turn errors and signals into one line on standard error and an exit status.

    `words` are the user's; `debug` shows the traceback of an error that is no bad input.

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
    except KeyboardInterrupt:
        _end("interrupted", INTERRUPTED)
    except Exception as error:
        text, status = _verdict(error, words)
        if status == FAILED and debug:
            traceback.print_exc()
        _end(text, status)
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
    """Return what raises for a signal, but for one that follows at once.

    Not while a module is imported: some libraries catch everything there and go on without what
    was not imported. The signal is raised again soon after, for the handler that then stands.
    """
    raised_at = -inf

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal raised_at
        if _imports(frame):
            signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
            signal.setitimer(signal.ITIMER_REAL, _IMPORT_S)
        elif time.monotonic() >= raised_at + ONCE_S:
            raised_at = time.monotonic()
            raise _Interrupt if number == signal.SIGINT else SystemExit(128 + number)

    return handle


def _imports(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTING:
            return True
        frame = frame.f_back
    return False


def _text(error: Exception) -> str:
    if isinstance(error, CycloptsError):
        if isinstance(error, UnusedCliTokensError):
            got = listed([printable(one) for one in error.unused_tokens or ()], most=3)
            return f"expected no more words, got {got}"
        if isinstance(error, MissingArgumentError) and (name := error.keyword):
            return f"{name}: expected a value (one that begins with - is written {name}=-1)"
        return " ".join(str(error).split())
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or "not enough memory"


def _verdict(error: Exception, words: Sequence[str]) -> tuple[str, int]:
    """Return what to say of an error, and the exit status."""
    if isinstance(error, InputError | CycloptsError):
        return _text(error), BAD_INPUT
    if isinstance(error, FailureError | OSError | MemoryError):
        is_bad = isinstance(error, _BAD_PATH) and _is_named(error, words)
        return _text(error), BAD_INPUT if is_bad else FAILED
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        if extra := _EXTRAS.get(package):
            return f"{words[0]} needs {package}: pip install 'heliarch[{extra}]'", BAD_INPUT
    return f"unexpected {type(error).__name__}: {error} (--debug shows where)", FAILED


def _is_named(error: OSError, words: Sequence[str]) -> bool:
    """Whether a path, or the folder that it is in, is one of the user's words."""
    path = Path(os.fsdecode(error.filename or "")).absolute()
    named = (Path(word.rpartition("=")[2]).absolute() for word in words)
    return any(path.is_relative_to(one) for one in named if one != Path.cwd())


def _end(text: str, status: int) -> NoReturn:
    try:
        sys.stdout.flush()
    except OSError:  # At the end of the process, the rest of the buffer would fail again.
        _discard_output()
    sys.exit(complain(text, status))


def _discard_output() -> None:
    with suppress(OSError, ValueError):  # A test's standard output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
