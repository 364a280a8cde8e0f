"""Keys that control a replay, read one by one from the terminal, which is restored afterwards."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TypeAlias

KEYS_IN_WORDS: Final = "space pauses, s steps a cycle, + - pace, arrows seek (10 s, 1 min), q ends"

UP, DOWN, RIGHT, LEFT = "A", "B", "C", "D"
"""Arrow keys, by the end of their escape sequences; the other keys are their characters."""

_KEYS: Final = re.compile(rb"\x1b[\[O]([A-D])|([ s+=q-])")

Keyboard: TypeAlias = Callable[[float], str]
"""Returns the next key that is pressed within a time [s], or an empty string."""


def no_keyboard(seconds: float) -> str:
    """Wait for the time: standard input is no terminal."""
    time.sleep(max(seconds, 0.0))
    return ""


class TerminalKeyboard:
    """The keys of a terminal in cbreak mode, by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._typed = b""

    def wait(self, seconds: float) -> str:
        if not _KEYS.search(self._typed) and select.select([self._descriptor], [], [], seconds)[0]:
            self._typed += os.read(self._descriptor, 1024)
        if (key := _KEYS.search(self._typed)) is None:
            return ""
        self._typed = self._typed[key.end() :]
        return (key[1] or key[2]).decode()


def has_keyboard() -> bool:
    """Whether standard input is a terminal that listens to this program."""
    if not sys.stdin.isatty():
        return False
    try:
        # In the background a read would stop the program.
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True  # It is not the controlling terminal, so a read does not stop the program.


@contextmanager
def keyboard() -> Iterator[Keyboard]:
    """Read the terminal key by key, without echo, as long as the context lasts."""
    if not has_keyboard():
        yield no_keyboard
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    # After Ctrl-Z the shell restores its own mode; `fg` must set ours again.
    continued = signal.signal(signal.SIGCONT, lambda *_: tty.setcbreak(descriptor))
    tty.setcbreak(descriptor)
    try:
        yield TerminalKeyboard(descriptor).wait
    finally:
        signal.signal(signal.SIGCONT, continued)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
