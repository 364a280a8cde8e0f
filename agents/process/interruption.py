"""A run that is asked to end: by Ctrl-C, or by SIGTERM as `docker stop` and systemd send it."""

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
    """Count Ctrl-C and SIGTERM instead of raising; a signal that is ignored stays ignored."""
    interruption = Interruption()

    def interrupt(signum: int, frame: FrameType | None) -> None:
        interruption.count += 1

    before = {
        number: signal.signal(number, interrupt)
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) is not signal.SIG_IGN  # As of a command in the background.
    }
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
