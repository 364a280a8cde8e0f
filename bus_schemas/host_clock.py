"""The clock of the launcher's host, as an agent on another host knows it."""

from __future__ import annotations

import logging
import time
from typing import Final

log = logging.getLogger(__name__)

_DRIFT: Final = 10_000
"""Clocks of two hosts drift apart by less than one part in this number."""

CLOCK_BYTES: Final = 16


class HostClock:
    """The monotonic clock of another host, by the messages that come from there.

    The fastest message sets it. It then falls back by more than the two clocks run apart, until the
    next fast message sets it. The processes of this host share one clock in `memory`: by how much
    this host's is ahead, and when that was set; 0: never.
    """

    def __init__(self, memory: memoryview | None = None) -> None:
        self._memory = memoryview(bytearray(CLOCK_BYTES)).cast("q") if memory is None else memory

    def observe(self, published_ns: int, came_ns: int) -> None:
        if published_ns <= 0:
            return
        if not self._memory[1]:
            log.info("this host's clock is ahead by %.6f s", (came_ns - published_ns) / 1e9)
        elif self.at(came_ns) >= published_ns:
            return
        self._memory[0], self._memory[1] = came_ns - published_ns, came_ns

    def at(self, host_ns: int) -> int:
        """Return what the other clock shows at a time of this host's clock."""
        ahead_ns, set_ns = self._memory
        return host_ns - ahead_ns - (host_ns - set_ns) // _DRIFT if set_ns else host_ns

    def now_ns(self) -> int:
        return self.at(time.monotonic_ns())
