"""Where every command begins and ends: signals, errors and exit status."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, ClassVar, Final, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from bus_schemas.errors import FailureError, InputError
from bus_schemas.printable import printable

BEGAN_AT: Final = time.monotonic()
"""When the program was started [s]."""

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130
"""Ctrl-C: 128 and the number of the signal, as shells count. So SIGTERM is 143, SIGHUP 129."""

_LOOK_S: Final = 0.1
"""How often to look whether an exception that ends the program got lost."""

_BAD_PATH: Final = (
    FileExistsError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
_EXTRAS: Final = {
    "cryptography": "keys",
    "distributed": "cluster",
    "foxglove": "foxglove",
    "pymodbus": "modbus",
    "sunspec2": "modbus",
}
"""Packages that not every user needs, and the extra that installs them."""

_UsageError: Final[Any] = typer.BadParameter.__mro__[1]
"""What typer raises for an option or argument that it cannot accept."""


class CommandLine(TyperGroup):
    """The command line. Its commands return their exit status, or None for success."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - Typer's type is private
        return _without_types(super().get_params(ctx), ctx)

    def main(self, *args: Any, **options: Any) -> NoReturn:
        """Run the command that the user named, and leave with its exit status."""
        options["standalone_mode"] = False
        with boundary():
            status = super().main(*args, **options)
            sys.stdout.flush()
        sys.exit(status or OK)


class Command(TyperCommand):
    """One command, whose `--report` may be followed by a file *.html."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - Typer's type is private
        return _without_types(super().get_params(ctx), ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - Typer's type is private
        """Read the options; a `--report` without a file gets an empty value."""
        found = []
        for before, arg, after in zip(["", *args], args, [*args[1:], ""], strict=False):
            # As `--out "$FOLDER"` has it if that is not set: as a path it would be this folder.
            if not arg or (arg.startswith("--") and arg.endswith("=")):
                option = next((word for word in (arg, before) if word[:2] == "--"), "an argument")
                raise InputError(f"{option.rstrip('=')}: expected a value, got nothing")
            if re.search("[\ud800-\udfff]", arg):
                raise InputError(f"{arg}: expected UTF-8, got bytes that are not")
            is_bare = arg == "--report" and not after.endswith(".html")
            found.append("--report=" if is_bare else arg)
        return super().parse_args(ctx, found)


def _without_types(params: list[Any], ctx: object) -> list[Any]:
    """Let the help show no `<bool>` and `<path>` beside flags and arguments."""
    for param in params:
        if param.param_type_name == "argument" or str(param.display_type_rich(ctx)) == "<bool>":
            param.display_type_rich = lambda ctx: ""
    return params


@contextmanager
def boundary() -> Iterator[None]:
    """Turn errors and signals into one line on standard error and an exit status.

    Ctrl-C raises KeyboardInterrupt, SIGTERM and SIGHUP raise SystemExit, so that every `with` and
    `finally` cleans up. A signal that is ignored (`nohup`) stays ignored.
    """
    handlers = {signal.SIGINT: _interrupt, signal.SIGTERM: _leave, signal.SIGHUP: _leave}
    before = {
        number: signal.signal(number, handler)
        for number, handler in handlers.items()
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    report, sys.unraisablehook = sys.unraisablehook, _unless_ending(sys.unraisablehook)
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
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        extra = f"pip install 'heliarch[{_EXTRAS[error.name]}]'"
        _end(f"{error.name} is not installed: {extra}", BAD_INPUT)
    except _UsageError as error:
        _end(_usage_text(error), BAD_INPUT)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = report
        for number, handler in before.items():
            signal.signal(number, handler)


def complain(text: object, status: int) -> int:
    """Say on standard error what is wrong; return the exit status."""
    sys.stderr.write(f"heliarch: {printable(str(text))}\n")
    return status


class _Interrupt(KeyboardInterrupt):
    """Ctrl-C, as a subclass of KeyboardInterrupt.

    If a plain KeyboardInterrupt passes through an `exec`, which makes named tuples and data classes
    while modules are imported, Python ends itself by SIGINT, without an exit status.
    """


class _Leave(SystemExit):
    """The end by SIGTERM or SIGHUP. `newest` returns the newest one while it is on its way."""

    newest: ClassVar[Callable[[], _Leave | None]] = lambda: None

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        _Leave.newest = weakref.ref(self)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise _Interrupt


def _leave(number: int, frame: FrameType | None) -> None:
    """Raise `_Leave`, and once more if it gets lost: otherwise the program would go on.

    Python drops what is raised in a callback of a weak reference, and each import ends with one.
    Libraries in C may drop any error.
    """
    if _Leave.newest() is not None:  # `timeout` sends its signal twice.
        return
    signal.signal(signal.SIGALRM, lambda *_: _leave(number, None))
    signal.setitimer(signal.ITIMER_REAL, _LOOK_S, _LOOK_S)
    raise _Leave(number)


def _unless_ending(
    report: Callable[[sys.UnraisableHookArgs], object],
) -> Callable[[sys.UnraisableHookArgs], None]:
    """Return the hook that reports what Python has dropped, except what ends the program.

    A dropped Ctrl-C is sent once more. Only this hook shows that it was lost: `_Interrupt`, unlike
    `_Leave`, may also have been caught on purpose.
    """

    def hook(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, _Interrupt):
            signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
            signal.setitimer(signal.ITIMER_REAL, _LOOK_S)
        elif not isinstance(dropped.exc_value, _Leave):
            report(dropped)

    return hook


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _usage_text(error: Any) -> str:  # noqa: ANN401 - Typer's type is private
    """Return a complaint about the command line; about a value as `OPTION: expected X, got Y`."""
    details = getattr(error.__cause__, "errors", None)
    if details is None:
        return " ".join(error.format_message().split())
    detail = details()[0]
    what = re.sub("Input should be|Value error, .* is not", "expected", detail["msg"])
    what = re.sub("expected (?=greater|less)", "expected a number ", what).partition(", unable")[0]
    option = error.param.get_error_hint().strip("'")
    return f"{option}: {what.rstrip('.')}, got {detail['input']}"


def _end(text: str, status: int) -> NoReturn:
    try:
        sys.stdout.flush()
    except OSError:  # What is left in the buffer would fail once more at the end of the process.
        _discard_output()
    sys.exit(complain(text, status))


def _discard_output() -> None:
    with suppress(OSError, ValueError):  # A test's standard output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
