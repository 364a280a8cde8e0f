"""What a real-time process does between the cycles, when nobody waits for it.

It settles its stopwatch, collects its garbage and says what it has counted. Each process has a
moment of its own for it in the second half of the cycle, by when the loop has long closed: if all
took theirs at once, or right after their last message, they would take the processors from those
who still have to answer.

An interlude begins once the process has done its part of the cycle, and ends before the next tick
and after 2 ms at the latest: what is noted is settled one by one up to then, and garbage and words
have their turn only where there is time left for them. What is left waits for the next cycle. A
process for which the tick came too soon does not wait for its own moment there, but goes on as soon
as it has done its part: it has the most time then, however short the cycle and late its moment are.
Whoever finds no time at all for seconds, because it is never done before the next tick or never
idle, takes a piece of half a millisecond at once. So an interlude is never far, whatever one before
it took, and costs no deadline where the plant keeps its deadlines at all.
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

_LONGEST_NS: Final = 2_000_000
"""How long an interlude settles at most: some 600 moments, 15 cycles of a plant of 17 inverters."""

_RESERVE_NS: Final = 100_000
"""Before the next tick an interlude is over."""

_PIECE_NS: Final = 250_000
"""What collecting garbage, and saying something, may take each: several times what they do take."""

_PATIENCE_NS: Final = 2_000_000_000
"""How long, and at least for how many whole cycles, an interlude waits for a time to be taken."""

_PATIENCE_CYCLES: Final = 2


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
        self._patience_ns = max(_PATIENCE_NS, _PATIENCE_CYCLES * cycle_ns)
        self._now_ns = now_ns
        self._start_ns = 0
        self._told_ns = 0
        self._next_ns: int | None = None
        self._waits_since_ns: int | None = None
        self._tick_came_too_soon = False

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
        """Do what cannot wait any longer, whoever may be waiting for this process.

        That is to settle as much as has come in beyond what may be noted, and to take a piece of an
        interlude that has found no time for seconds.
        """
        self._stopwatch.make_room()
        if self._next_ns is None or (now_ns := self._now_ns()) < self._next_ns:
            return
        if self._waits_since_ns is None:
            self._waits_since_ns = now_ns
        elif now_ns - self._waits_since_ns > self._patience_ns:
            self._stopwatch.settle(now_ns + _PIECE_NS)
            self._collect_and_tell(self._now_ns() + 2 * _PIECE_NS)
            self._rest(now_ns)

    def consider(self, cycle: int) -> None:
        """Take the interlude if it is its time.

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
        if into_ns < self._offset_ns and not self._tick_came_too_soon:
            self._next_ns = now_ns - into_ns + self._offset_ns
        else:
            self._take(now_ns, now_ns - into_ns + self._cycle_ns)

    def _is_busy(self, cycle: int, now_ns: int) -> bool:
        return cycle <= (now_ns - self._start_ns) // self._cycle_ns

    def _take(self, now_ns: int, tick_ns: int) -> None:
        """Do as much as there is time for; go on in the next cycle with what is left."""
        ends_ns = tick_ns - _RESERVE_NS
        is_settled = self._stopwatch.settle(min(now_ns + _LONGEST_NS, ends_ns))
        if is_settled and self._collect_and_tell(ends_ns):
            self._rest(now_ns)
            return
        self._tick_came_too_soon = is_settled or self._now_ns() >= ends_ns
        self._next_ns = tick_ns
        if not self._tick_came_too_soon:
            self._next_ns += self._offset_ns
            self._waits_since_ns = None  # It had all the time that one may have.

    def _collect_and_tell(self, ends_ns: int) -> bool:
        """Collect garbage, and say what has changed if it is time to; return whether all is done.

        Neither can be done by halves, so each is begun only if it will be over at the end.
        """
        now_ns = self._now_ns()
        if now_ns + _PIECE_NS > ends_ns:
            return False
        gc.collect()
        if now_ns < self._told_ns + _TELL_EVERY_NS:
            return True
        if self._now_ns() + _PIECE_NS > ends_ns:
            return False
        self._told_ns = now_ns
        self._tell()
        return True

    def _rest(self, now_ns: int) -> None:
        """Let the next one be some cycles after this one."""
        under_way = (now_ns - self._start_ns) // self._cycle_ns
        next_cycle = under_way + self._cycles_between
        self._next_ns = self._start_ns + next_cycle * self._cycle_ns + self._offset_ns
        self._waits_since_ns = None
        self._tick_came_too_soon = False
