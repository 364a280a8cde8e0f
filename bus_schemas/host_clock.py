"""The clock of the launcher's host, as an agent on another host knows it."""

from __future__ import annotations

import logging
import time
from typing import Final

log = logging.getLogger(__name__)

_DRIFT: Final = 10_000
"""Clocks of two hosts run apart by less than one part in so many."""


class HostClock:
    """The monotonic clock of another host, by the messages that come from there.

    The message that came fastest sets it. It then falls back by more than the two clocks run apart,
    until the next fast message sets it.
    """

    def __init__(self) -> None:
        self._ahead_ns: int | None = None
        self._set_ns = 0

    def hear(self, published_ns: int, came_ns: int) -> None:
        """Take in a message: its publish time there, and when it came by this host's clock."""
        if published_ns <= 0:
            return
        if self._ahead_ns is None:
            log.info("this host's clock is ahead by %.6f s", (came_ns - published_ns) / 1e9)
        elif self.at(came_ns) >= published_ns:
            return
        self._ahead_ns, self._set_ns = came_ns - published_ns, came_ns

    def at(self, host_ns: int) -> int:
        """Return what the other clock shows at a time of this host's clock."""
        if self._ahead_ns is None:
            return host_ns
        return host_ns - self._ahead_ns - (host_ns - self._set_ns) // _DRIFT

    def now_ns(self) -> int:
        return self.at(time.monotonic_ns())
