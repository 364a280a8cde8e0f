"""What a real-time process does between the cycles, when nobody waits for it.

It settles its stopwatch, collects its garbage and says what it has counted. Each process has a
moment of its own for it in the second half of the cycle, by when the loop has long closed: if all
took theirs at once, or right after their last message, they would take the processors from those
who still have to answer.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from typing import Final

from agents.stopwatch import Stopwatch

_EARLIEST_SHARE: Final = 0.5
_LATEST_SHARE: Final = 0.9
"""Shares of the cycle between which the processes have their moments."""

_EVERY_NS: Final = 200_000_000
"""From one interlude to the next: so seldom that they cost little, so often that each is short."""

_TELL_EVERY_NS: Final = 1_000_000_000
"""What has changed is said at most so often."""

_ASSUMED_NS: Final = 500_000
"""How long an interlude is thought to take before there has been one."""


class Interlude:
    """The interludes of one process.

    Parameters
    ----------
    stopwatch
        Settled in each of them.
    tell
        Called in some of them, once a second at most: says on the bus what has changed.
    cycle_ns
        Length of a cycle.
    place, places
        Which of all processes this is, from 0, and how many there are.
    now_ns
        The clock: monotonic nanoseconds.
    """

    def __init__(
        self,
        stopwatch: Stopwatch,
        tell: Callable[[], None],
        cycle_ns: int,
        place: int,
        places: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._stopwatch = stopwatch
        self._tell = tell
        self._cycle_ns = cycle_ns
        share = _EARLIEST_SHARE + (_LATEST_SHARE - _EARLIEST_SHARE) * place / places
        self._offset_ns = round(share * cycle_ns)
        self._cycles_between = -(-_EVERY_NS // cycle_ns)
        self._now_ns = now_ns
        self._took_ns = _ASSUMED_NS
        self._start_ns = 0
        self._told_ns = 0
        self._next_ns: int | None = None

    def begin(self, start_time_ns: int) -> None:
        """Let cycle 0 begin at a time of the clock."""
        self._start_ns = start_time_ns
        self._next_ns = start_time_ns + self._offset_ns

    def left_s(self, cycle: int) -> float | None:
        """Return the time up to the next interlude; None where there is nothing to wait for.

        That is before cycle 0, and while the process is still busy: see `consider`.
        """
        if self._next_ns is None:
            return None
        now_ns = self._now_ns()
        if now_ns < self._next_ns:
            return (self._next_ns - now_ns) / 1e9
        return None if self._is_busy(cycle, now_ns) else 0.0

    def make_room(self) -> None:
        """Settle at once if too much is noted, whoever may be waiting for this process."""
        if not self._stopwatch.overfull:
            return
        if self._next_ns is None:
            self._stopwatch.settle()  # Arming can take long, and what is noted then is nothing.
        else:
            self._take(self._now_ns())

    def consider(self, cycle: int) -> None:
        """Take the interlude if it is its time, and there is enough of it before the next tick.

        Parameters
        ----------
        cycle
            Cycle that the process is in: it has done its part of those before. While that one is
            under way the process is busy, and its interlude waits until it has done its part.
        """
        self.make_room()
        if self._next_ns is None:
            return
        now_ns = self._now_ns()
        if now_ns < self._next_ns or self._is_busy(cycle, now_ns):
            return
        into_ns = (now_ns - self._start_ns) % self._cycle_ns
        if into_ns < self._offset_ns:
            self._wait(now_ns, 0)
        elif into_ns + 2 * self._took_ns > self._cycle_ns:
            self._wait(now_ns, 1)
        else:
            self._take(now_ns)

    def _is_busy(self, cycle: int, now_ns: int) -> bool:
        return cycle <= (now_ns - self._start_ns) // self._cycle_ns

    def _wait(self, now_ns: int, cycles: int) -> None:
        """Let the next one be in this cycle or so many later."""
        under_way = (now_ns - self._start_ns) // self._cycle_ns
        self._next_ns = self._start_ns + (under_way + cycles) * self._cycle_ns + self._offset_ns

    def _take(self, now_ns: int) -> None:
        self._stopwatch.settle()
        gc.collect()
        if now_ns >= self._told_ns + _TELL_EVERY_NS:
            self._told_ns = now_ns
            self._tell()
        # What it took last time it will take again: a mean would forget too slowly.
        self._took_ns = self._now_ns() - now_ns
        self._wait(now_ns, self._cycles_between)
