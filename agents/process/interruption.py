"""Ctrl-C during a run. The command itself handles SIGTERM."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interruption:
    """How often the user has asked for an end."""

    def __init__(self) -> None:
        self.count = 0

    def __bool__(self) -> bool:
        return self.count > 0

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self and (left_s := until - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 0.05))


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Count Ctrl-C instead of raising KeyboardInterrupt; where it is ignored, it stays ignored."""
    interruption = Interruption()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # As of a command in the background.
        yield interruption
        return

    def interrupt(signum: int, frame: FrameType | None) -> None:
        interruption.count += 1

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGINT, before)
