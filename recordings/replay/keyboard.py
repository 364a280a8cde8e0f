"""Keys that steer a replay: read one by one from the terminal, which is left as it was found."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Final, Protocol


class Key(Enum):
    """What a key asks for."""

    PAUSE = "space: pause, go on"
    STEP = "s: one cycle"
    FASTER = "+: twice as fast"
    SLOWER = "-: half as fast"
    FORWARD = "right: 10 s on"
    BACK = "left: 10 s back"
    FAR_FORWARD = "up: 1 min on"
    FAR_BACK = "down: 1 min back"
    QUIT = "q: end"


KEYS_IN_WORDS: Final = "space pauses, s steps a cycle, + - rate, arrows seek (10 s, 1 min), q ends"

_KEY_OF: Final = {
    b" ": Key.PAUSE,
    b"s": Key.STEP,
    b"+": Key.FASTER,
    b"=": Key.FASTER,  # the same key, without shift
    b"-": Key.SLOWER,
    b"q": Key.QUIT,
}
_ARROW_OF: Final = {
    b"A": Key.FAR_FORWARD,
    b"B": Key.FAR_BACK,
    b"C": Key.FORWARD,
    b"D": Key.BACK,
}
_MOST_BYTES: Final = 64


class Keyboard(Protocol):
    """Where keys come from."""

    def wait(self, seconds: float) -> list[Key]:
        """Return the keys that were pressed, at once if there are any, or after a time."""


class NoKeyboard:
    """Nobody is there to press a key."""

    def wait(self, seconds: float) -> list[Key]:
        """Wait for the time."""
        time.sleep(max(seconds, 0.0))
        return []


class TerminalKeyboard:
    """The terminal's keys.

    Parameters
    ----------
    descriptor
        File descriptor of the terminal, in cbreak mode.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def wait(self, seconds: float) -> list[Key]:
        """Return the keys that were pressed, at once if there are any, or after a time."""
        readable, _, _ = select.select([self._descriptor], [], [], max(seconds, 0.0))
        # A terminal hands over the bytes of an arrow key in one go.
        return keys_in(os.read(self._descriptor, _MOST_BYTES)) if readable else []


def keys_in(typed: bytes) -> list[Key]:
    """Return the keys that a terminal's bytes stand for; what stands for none is passed over."""
    keys = []
    rest = typed
    while rest:
        if rest[:2] in (b"\x1b[", b"\x1bO"):
            key, rest = _ARROW_OF.get(rest[2:3]), rest[3:]
        else:
            key, rest = _KEY_OF.get(rest[:1]), rest[1:]
        if key is not None:
            keys.append(key)
    return keys


def has_keyboard() -> bool:
    """Whether standard input is a terminal that listens to this program."""
    if not sys.stdin.isatty():
        return False
    try:
        # In the background a read would stop the program.
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True  # Not the terminal that started it: nobody stops it there.


@contextmanager
def keyboard() -> Iterator[Keyboard]:
    """Take the terminal's keys one by one, unseen, for as long as the context lasts."""
    if not has_keyboard():
        yield NoKeyboard()
        return
    with keys_of(sys.stdin.fileno()) as keys:
        yield keys


@contextmanager
def keys_of(descriptor: int) -> Iterator[TerminalKeyboard]:
    """Put a terminal into cbreak mode, and back into the mode it was in."""
    before = termios.tcgetattr(descriptor)
    # Ctrl-Z: the shell takes its own mode back, and fg must bring ours again.
    continued = signal.signal(signal.SIGCONT, lambda *_: tty.setcbreak(descriptor))
    tty.setcbreak(descriptor)
    try:
        yield TerminalKeyboard(descriptor)
    finally:
        signal.signal(signal.SIGCONT, continued)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
