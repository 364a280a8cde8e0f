"""A run that is asked to end: by Ctrl-C, or by SIGTERM as `docker stop` sends it."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from types import FrameType
from typing import Final

ONCE_S: Final = 1.0
"""Signals so soon after each other count as one: `timeout` sends two."""


class Interruption:
    """How often the user has asked for an end."""

    def __init__(self) -> None:
        self.count = 0
        self._asked_at = -inf

    def __bool__(self) -> bool:
        return self.count > 0

    def ask(self) -> None:
        now = time.monotonic()
        if now >= self._asked_at + ONCE_S:
            self.count, self._asked_at = self.count + 1, now

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self and (left_s := until - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 0.05))


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Count Ctrl-C and SIGTERM instead of raising; a signal that is ignored stays ignored."""
    interruption = Interruption()

    def interrupt(signum: int, frame: FrameType | None) -> None:
        interruption.ask()

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
