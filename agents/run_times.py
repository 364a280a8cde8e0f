"""Times of the run, as an agent knows them."""

from __future__ import annotations

import logging
from functools import cache, partial
from math import ceil
from typing import Any, Final

from agents.agent import Agent
from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.tree import PLANT

log = logging.getLogger(__name__)

_SUSPENDED_S: Final = 2.0
"""A plant that is further behind than this and the hold goes to the cycle under way, as all others
do: its machine was suspended."""


class RunTimes:
    """Times on the clock of an agent.

    start_ns: Beginning of cycle 0. None: in lockstep, or not known yet.
    is_estimated: Whether the agent took it from when a message came.
    end_cycle: The first cycle that does not take place.
    stop_heard: Whether the plant has said that the run ends there.
    skipped_cycles: Cycles that were over before the agent was through them.
    """

    def __init__(self, plan: RunPlan, agent: Agent[Any]) -> None:
        self.timing = timing = plan.timing
        self.start_ns: int | None = None
        self.is_estimated = False
        self.end_cycle = timing.cycles
        self.stop_heard = False
        self.skipped_cycles = 0
        suspended = ceil(_SUSPENDED_S * 1e9 / max(timing.cycle_wall_ns, 1))
        self._has_own_clock = PLANT in plan.access.external
        self._most_behind = 0 if agent.may_skip else max(plan.control.hold_cycles, suspended)
        self._deadline_after_ns = cache(partial(plan.deadlines.deadline_ns, agent.name))

    def start(self, start_ns: int) -> None:
        if not self.timing.lockstep:
            self.start_ns = start_ns

    def on_this_clock(self, start_ns: int, now_ns: int, said_ns: int | None = None) -> int:
        """Return when a cycle began; now, where the time seems to be of another host's clock.

        said_ns: When it was said; by default the beginning itself must be near.
        """
        said_ns = start_ns if said_ns is None else said_ns
        self.is_estimated = not self.timing.is_on_clock(said_ns, now_ns)
        if self.is_estimated and self.start_ns is None:
            log.warning("the cycle begins now, not at %d: that is another clock", start_ns)
        return now_ns if self.is_estimated else start_ns

    def start_by(self, dispatch: Message, now_ns: int) -> int:
        """Return when cycle 0 began, by the dispatch of a cycle: it may have come late."""
        began_ns, self.is_estimated = dispatch.ready_time_ns, False
        if self._has_own_clock or not began_ns:
            # The plant may be far behind: when it sent the dispatch tells whose clock it has.
            began_ns = self.on_this_clock(began_ns, now_ns, dispatch.publish_time_ns)
        return began_ns - dispatch.cycle * self.timing.cycle_wall_ns

    def begins_earlier(self, dispatch: Message, now_ns: int) -> bool:
        """Begin earlier if a dispatch shows that the message of the estimate came late."""
        if self.start_ns is None or not 0 <= dispatch.cycle < self.end_cycle:
            return False
        start_ns = self.start_by(dispatch, now_ns)
        is_earlier = start_ns < self.start_ns
        self.start_ns = min(start_ns, self.start_ns)
        return is_earlier

    def deadline_ns(self, cycle: int, stage: str) -> int | None:
        """Return when a stage of the agent closes at the latest; None: it waits."""
        if cycle < 0 or self.start_ns is None:
            return None
        begin_ns = self.start_ns + cycle * self.timing.cycle_wall_ns
        return begin_ns + self._deadline_after_ns(stage)

    def time_ns(self, cycle: float) -> int:
        """Return when a cycle, or a part of it, begins; lockstep has no such time."""
        return (self.start_ns or 0) + round(cycle * self.timing.cycle_wall_ns)

    def goes_on_in(self, cycle: int, now_ns: int) -> int | None:
        """Return the cycle under way if an agent in this cycle is too far behind it."""
        if self.start_ns is None:
            return None
        under_way = (now_ns - self.start_ns) // self.timing.cycle_wall_ns
        is_behind = min(under_way, self.end_cycle) > cycle + self._most_behind
        return min(under_way, self.end_cycle) if is_behind else None
