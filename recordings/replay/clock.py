"""When each recorded message is due: its position on a clock, and the time of that position."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Literal, TypeAlias

from agents.plan import RunPlan
from recordings.read.reader import RecordedMessage

ClockKind: TypeAlias = Literal["sim", "wall"]
"""`sim`: a cycle begins at its simulated time; within it, messages are as far apart as when they
were published. `wall`: all messages are as far apart as when they were published."""


def positions(
    records: Iterable[RecordedMessage], plan: RunPlan, kind: ClockKind
) -> Iterator[tuple[int, RecordedMessage]]:
    """Yield messages with their positions on a clock [ns]; only differences matter.

    No position is before that of an earlier message.
    """
    cycle, began_ns, last_ns = -1, 0, -(1 << 62)
    for record in records:
        position_ns = record.publish_time_ns
        if kind == "sim":
            if record.cycle > cycle:
                cycle, began_ns = record.cycle, record.publish_time_ns
            elapsed_ns = min(record.publish_time_ns - began_ns, plan.cycle_ns)
            position_ns = plan.sim_time_ns(record.cycle) + elapsed_ns
        last_ns = max(last_ns, position_ns)
        yield last_ns, record


class PlaybackClock:
    """Maps positions to times of the monotonic clock.

    Every time is counted from one anchor, so errors do not add up. Only a pause, a seek and a
    change of rate set a new anchor.
    The rate is in seconds of the clock per second; at 0 everything is due at once.
    """

    def __init__(
        self, rate: float, *, paused: bool = False, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.rate = rate
        self.paused = paused
        self.now_ns = now_ns
        self._position_ns = 0
        self._moment_ns = now_ns()

    def move_to(self, position_ns: int) -> None:
        """Make a position due now."""
        self._position_ns, self._moment_ns = position_ns, self.now_ns()

    def due_ns(self, position_ns: int) -> int:
        """Return the monotonic time at which a position is reached [ns]."""
        if self.rate == 0.0:
            return self._moment_ns
        return self._moment_ns + round((position_ns - self._position_ns) / self.rate)

    def toggle_pause(self) -> None:
        """Pause, or go on from the same position."""
        self.move_to(self._here_ns())
        self.paused = not self.paused

    def set_rate(self, rate: float) -> None:
        """Go on from here at another rate."""
        self.move_to(self._here_ns())
        self.rate = rate

    def _here_ns(self) -> int:
        if self.paused:
            return self._position_ns
        return self._position_ns + round((self.now_ns() - self._moment_ns) * self.rate)
