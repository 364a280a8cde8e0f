"""Signals: unfinished files are cleaned up, what was measured is told and written."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def leaving_on_sigterm() -> Iterator[None]:
    """Let SIGTERM leave through every `finally`, as Ctrl-C does by itself."""

    def leave(signum: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + signum)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Termination:
    """Whether a signal has asked for the end of a command.

    Ctrl-C is one only in `held`; elsewhere it is a KeyboardInterrupt, or what is run counts it.

    Attributes
    ----------
    number
        The first one; None: there was none.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._is_held = False

    def hear(self, signum: int, frame: FrameType | None) -> None:
        """Do once what Ctrl-C would do now; `timeout` sends its signal twice."""
        if self.number is not None:
            return
        self.number = signum
        if self._is_held:
            return
        interrupt = signal.getsignal(signal.SIGINT)
        if not callable(interrupt):  # A shell's background jobs ignore Ctrl-C.
            raise KeyboardInterrupt
        interrupt(signal.SIGINT, frame)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Bring what is under way to its end: a signal changes the exit status alone.

        A second Ctrl-C ends it all the same.
        """
        interrupt = signal.getsignal(signal.SIGINT)

        def hold(signum: int, frame: FrameType | None) -> None:
            signal.signal(signal.SIGINT, interrupt)
            if self.number is None:
                self.number = signum

        if callable(interrupt):  # A shell's background jobs ignore Ctrl-C.
            signal.signal(signal.SIGINT, hold)
        self._is_held = True
        try:
            yield
        finally:
            self._is_held = False
            if callable(interrupt):
                signal.signal(signal.SIGINT, interrupt)

    def status(self, otherwise: int) -> int:
        """Return the exit status: 128 and the number of the signal, if there was one."""
        return otherwise if self.number is None else 128 + self.number


@contextmanager
def terminable() -> Iterator[Termination]:
    """Let SIGTERM and SIGHUP do what Ctrl-C does; one that is ignored (`nohup`) stays so."""
    termination = Termination()
    heard = [
        signum
        for signum in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(signum) is not signal.SIG_IGN
    ]
    before = [signal.signal(signum, termination.hear) for signum in heard]
    try:
        yield termination
    finally:
        for signum, handler in zip(heard, before, strict=True):
            signal.signal(signum, handler)
