"""When each recorded message is due: positions in the recording, and moments on the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from agents.plan import RunPlan
from recordings.read.reader import RecordedMessage


class Spacing(Protocol):
    """Says where in a recording a message lies [ns]. Only differences mean something."""

    def position_ns(self, record: RecordedMessage) -> int:
        """Return the position of the next message in the order of the recorded."""


class RecordedSpacing:
    """Messages are as far apart as they were published, whatever that is in simulated time."""

    def position_ns(self, record: RecordedMessage) -> int:
        """Return its publish time."""
        return record.publish_time_ns


class SimulatedSpacing:
    """A cycle begins when it does in simulated time; within it messages keep their spacing.

    A lockstep run, whose cycles took a few milliseconds each, is replayed as the plant would have
    lived through it.

    Parameters
    ----------
    plan
        Of the run: tells when its cycles are.
    """

    def __init__(self, plan: RunPlan) -> None:
        self._plan = plan
        self._cycle = -1
        self._began_ns = 0

    def position_ns(self, record: RecordedMessage) -> int:
        """Return the beginning of its cycle and what passed since that cycle's first message."""
        if record.cycle > self._cycle:
            self._cycle, self._began_ns = record.cycle, record.publish_time_ns
        elapsed_ns = record.publish_time_ns - self._began_ns
        return self._plan.sim_time_ns(record.cycle) + min(max(elapsed_ns, 0), self._plan.cycle_ns)


class PlaybackClock:
    """Maps positions in the recording to moments of the monotonic clock.

    Every moment is counted from one anchor, so errors do not add up. Only a pause, a seek and a
    change of rate set a new one.

    Parameters
    ----------
    rate
        Seconds in the recording in a second; 0: everything is due at once.
    now_ns
        The monotonic clock.

    Attributes
    ----------
    rate, now_ns
        See above.
    paused
        Whether it stands still.
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
        """Be at a position now."""
        self._position_ns, self._moment_ns = position_ns, self.now_ns()

    def due_ns(self, position_ns: int) -> int:
        """Return the monotonic time at which a position is reached [ns]."""
        if self.rate == 0.0:
            return self._moment_ns
        return self._moment_ns + round((position_ns - self._position_ns) / self.rate)

    def toggle_pause(self) -> None:
        """Stand still, or go on from there."""
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
