"""When the run begins and ends, as far as an agent knows."""

from __future__ import annotations

import logging
from functools import cache, partial

from agents.cycle import Deadlines
from agents.plan import Timing

log = logging.getLogger(__name__)


class RunTimes:
    """Times of a run on the clock of an agent.

    start_ns: Beginning of cycle 0. None: in lockstep, or not known yet.
    end_cycle: The first cycle that does not take place.
    stop_heard: Whether the plant has said that the run ends there.
    skipped_cycles: Cycles that were over before the agent was through them.
    """

    def __init__(self, timing: Timing, deadlines: Deadlines, agent: str) -> None:
        self.timing = timing
        self.start_ns: int | None = None
        self.end_cycle = timing.cycles
        self.stop_heard = False
        self.skipped_cycles = 0
        self._deadline_after_ns = cache(partial(deadlines.deadline_ns, agent))

    def start(self, start_ns: int) -> None:
        if not self.timing.lockstep:
            self.start_ns = start_ns

    def on_this_clock(self, start_ns: int, now_ns: int, said_ns: int | None = None) -> int:
        """Return when a cycle began; now, where the time must be of another host's clock.

        said_ns: When it was said; by default the beginning itself must be near.
        """
        if self.timing.is_on_clock(start_ns if said_ns is None else said_ns, now_ns):
            return start_ns
        log.warning("the cycle begins now, not at %d: that is another clock", start_ns)
        return now_ns

    def deadline_ns(self, cycle: int, stage: str) -> int | None:
        """Return when a stage of the agent closes at the latest; None: it waits."""
        if cycle < 0 or self.start_ns is None:
            return None
        begin_ns = self.start_ns + cycle * self.timing.cycle_wall_ns
        return begin_ns + self._deadline_after_ns(stage)

    def time_ns(self, cycle: float) -> int:
        """Return when a cycle, or a part of it, begins; lockstep has no such time."""
        return (self.start_ns or 0) + round(cycle * self.timing.cycle_wall_ns)

    def cycle_at(self, now_ns: int) -> int | None:
        """Return the cycle under way by the clock; None: no clock says."""
        if self.start_ns is None:
            return None
        return min((now_ns - self.start_ns) // self.timing.cycle_wall_ns, self.end_cycle)

    def forget_stop(self) -> None:
        """Let the run end where the plan says: the plant has begun a cycle after a stop."""
        self.end_cycle = self.timing.cycles
        self.stop_heard = False
