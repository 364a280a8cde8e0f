"""Keys that control a replay, read one by one from the terminal, which is restored afterwards."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TypeAlias

KEYS_IN_WORDS: Final = "space pauses and continues, q ends"

Keyboard: TypeAlias = Callable[[float], str]
"""Returns the next key that is pressed within a time [s], or an empty string."""


def no_keyboard(seconds: float) -> str:
    """Wait for the time: standard input is no terminal."""
    time.sleep(max(seconds, 0.0))
    return ""


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

    def wait(seconds: float) -> str:
        is_typed = select.select([descriptor], [], [], seconds)[0]
        return os.read(descriptor, 1).decode(errors="replace") if is_typed else ""

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield wait
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
